from .config import PARTS as PARTS, ReproduceConfig as ReproduceConfig
from .paper_tables import PAPER_TABLES as PAPER_TABLES
from .run_parts import reproduce as reproduce
from .verdicts import against_method as against_method, against_printed as against_printed
