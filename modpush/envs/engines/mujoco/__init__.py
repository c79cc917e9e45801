"""MuJoCo behind the boundary `Engine`; the only package that imports it."""
