from .curriculum import (
    Curriculum as Curriculum,
)
from .curriculum import (
    CurriculumConfig as CurriculumConfig,
)
from .curriculum import (
    CurriculumScenes as CurriculumScenes,
)
from .curriculum import (
    Phase as Phase,
)
from .frames import ActionFrame as ActionFrame
from .observation import (
    ENTRIES as ENTRIES,
)
from .observation import (
    PAPER_ENTRIES as PAPER_ENTRIES,
)
from .observation import (
    PATH_ENTRIES as PATH_ENTRIES,
)
from .observation import (
    Entry as Entry,
)
from .observation import (
    PushObservation as PushObservation,
)
from .rewards import (
    REWARD_TERMS as REWARD_TERMS,
)
from .rewards import (
    PushReward as PushReward,
)
from .rewards import (
    RewardConfig as RewardConfig,
)
from .rewards import (
    RewardTerm as RewardTerm,
)
