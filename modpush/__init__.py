"""Learning to push objects through clutter: parts that fit into any TorchRL pipeline.

The names below are the usual entry points; each package (`modpush.envs`, `modpush.planners`,
`modpush.encoders`, `modpush.mdp`, `modpush.agents`, `modpush.replay`, `modpush.recipes`,
`modpush.training`, `modpush.evaluation`) has more.

Names are imported on first use; `__init__.pyi` lists them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

__version__ = "0.1.0"
