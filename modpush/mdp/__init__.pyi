from .action_frame import ActionFrame as ActionFrame
from .contact_filter import ContactFilter as ContactFilter
from .curriculum import (
    Curriculum as Curriculum,
    CurriculumConfig as CurriculumConfig,
    Phase as Phase,
)
from .curriculum_scenes import CurriculumScenes as CurriculumScenes
from .delays import ActionDelay as ActionDelay, ObservationDelay as ObservationDelay
from .entry_list import latent_entry as latent_entry, resolve_entries as resolve_entries
from .noise import DepthNoise as DepthNoise, PoseNoise as PoseNoise
from .observation_entries import (
    ENTRIES as ENTRIES,
    PAPER_ENTRIES as PAPER_ENTRIES,
    PATH_AHEAD_ENTRIES as PATH_AHEAD_ENTRIES,
    PATH_ENTRIES as PATH_ENTRIES,
    POSE_ENTRIES as POSE_ENTRIES,
    Entry as Entry,
)
from .observation_inputs import (
    ObservationInputs as ObservationInputs,
    ObservationKeys as ObservationKeys,
)
from .observation_layout import fingerprint_differences as fingerprint_differences
from .push_history import PushHistory as PushHistory
from .push_observation import (
    MirroredObservation as MirroredObservation,
    PushObservation as PushObservation,
)
from .push_reward import PushReward as PushReward, RewardConfig as RewardConfig
from .reward_terms import REWARD_TERMS as REWARD_TERMS, RewardTerm as RewardTerm
from .step_outcome import RewardKeys as RewardKeys, StepOutcome as StepOutcome
from .stuck_recovery import StuckRecovery as StuckRecovery, recovering as recovering
