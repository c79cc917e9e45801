from .collecting import collect_demonstrations as collect_demonstrations
from .config import CollectConfig as CollectConfig
from .demonstration import Demonstration as Demonstration
from .loading import Demonstrations as Demonstrations, load_demonstrations as load_demonstrations
from .recording_env import RecordingEnv as RecordingEnv
from .replaying import replay_demonstration as replay_demonstration
from .store import DemonstrationStore as DemonstrationStore
