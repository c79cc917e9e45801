from .episodes import (
    Episode as Episode,
)
from .episodes import (
    Trajectory as Trajectory,
)
from .episodes import (
    run_episodes as run_episodes,
)
from .metrics import EpisodeMetrics as EpisodeMetrics
from .metrics import episode_metrics as episode_metrics
from .report import comparison_report as comparison_report
from .report import draw_results as draw_results
from .report import write_tables as write_tables
from .results import ResultStore as ResultStore
from .runner import EvaluationConfig as EvaluationConfig
from .runner import evaluate as evaluate
from .sets import (
    EVALUATION_SETS as EVALUATION_SETS,
)
from .sets import (
    SET_NAMES as SET_NAMES,
)
from .sets import (
    TUNING_SETS as TUNING_SETS,
)
from .sets import (
    EvaluationSet as EvaluationSet,
)
from .sets import (
    generate_set as generate_set,
)
from .sets import (
    load_set as load_set,
)
from .shortest import shortest_path as shortest_path
from .stats import bootstrap_interval as bootstrap_interval
from .stats import paired_t_test as paired_t_test
from .tables import (
    compare as compare,
)
from .tables import (
    format_table as format_table,
)
from .tables import (
    summarize as summarize,
)
from .tables import (
    to_display as to_display,
)
