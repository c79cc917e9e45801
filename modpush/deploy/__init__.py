"""From a depth image to an arm: what a policy needs on a real robot.

A calibrated `modpush.geometry.CameraModel` of any pose takes depth images. `Perception` removes the arm
by its joint angles (`ArmMask`), brings the image into the bird's-eye view that the policies were trained
with (`HeightMap`), and finds and tracks the pushed object by its known shape (`ObjectTracker`).

Names are imported on first use; `__init__.pyi` lists them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
