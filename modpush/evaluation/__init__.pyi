from .episodes import (
    Episode as Episode,
    Trajectory as Trajectory,
    run_episodes as run_episodes,
)
from .metrics import EpisodeMetrics as EpisodeMetrics, episode_metrics as episode_metrics
from .report import (
    comparison_report as comparison_report,
    draw_results as draw_results,
    write_tables as write_tables,
)
from .results import ResultStore as ResultStore
from .runner import EvaluationConfig as EvaluationConfig, evaluate as evaluate
from .sets import (
    EVALUATION_SETS as EVALUATION_SETS,
    SET_NAMES as SET_NAMES,
    TUNING_SETS as TUNING_SETS,
    EvaluationSet as EvaluationSet,
    generate_set as generate_set,
    load_set as load_set,
)
from .shortest import shortest_path as shortest_path
from .tables import (
    bootstrap_interval as bootstrap_interval,
    compare as compare,
    format_table as format_table,
    paired_t_test as paired_t_test,
    summarize as summarize,
    to_display as to_display,
)
