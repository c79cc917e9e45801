from .collecting import (
    CollectConfig as CollectConfig,
    collect_demonstrations as collect_demonstrations,
)
from .loading import Demonstrations as Demonstrations, load_demonstrations as load_demonstrations
from .minari_dataset import RecordedEpisode as RecordedEpisode
from .recording_env import RecordingEnv as RecordingEnv
