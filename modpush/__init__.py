"""Learning to push objects through clutter: parts that fit into any TorchRL pipeline.

Import what you need from its room: `modpush.envs`, `modpush.planners`, `modpush.encoders`,
`modpush.agents`, `modpush.replay`, `modpush.evaluation`. Importing `modpush` itself is free.
"""

__version__ = "0.1.0"

__all__ = ["__version__"]
