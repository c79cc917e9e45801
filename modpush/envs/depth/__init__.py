"""The bird's-eye depth image: ray casting and the two depth cameras."""
