"""The agent's side of the task: what it observes, what it is rewarded for, in which axes it acts.

Everything here is a TorchRL transform or a plain function, and nothing knows the simulator.

Names are imported on first use; `__init__.pyi` lists them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
