from .agent import FORMATS as FORMATS
from .agent import export_agent as export_agent
from .graphs import ObservationPolicy as ObservationPolicy
from .graphs import WindowPolicy as WindowPolicy
