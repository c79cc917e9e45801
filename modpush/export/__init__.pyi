from .agent import FORMATS as FORMATS, export_agent as export_agent
from .graphs import ObservationPolicy as ObservationPolicy, WindowPolicy as WindowPolicy
