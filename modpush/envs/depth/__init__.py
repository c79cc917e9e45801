"""The bird's-eye depth image: the interface of a depth camera, and the two that are shipped."""
