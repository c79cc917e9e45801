"""Whether an actor is a network and a distribution of its outputs, so that both can be called."""

from typing import Any

from tensordict.nn import TensorDictModule

__all__ = ["is_plain_call"]


def is_plain_call(network: Any, head: Any) -> bool:
    """Whether a network takes its inputs in order and gives its head's parameters in theirs.

    Then `head.distribution_class(**dict(zip(head.dist_keys, network.module(*inputs))))` is what the
    actor computes by way of a tensordict.

    Args:
        network: The actor's first module.
        head: Its last one, which makes the distribution.
    """
    return (
        type(network) is TensorDictModule
        and network.method is None
        and network._kwargs is None  # a dictionary of in_keys names the arguments
        and list(network.out_keys_source) == list(head.in_keys)
        and all(isinstance(key, str) for key in head.dist_keys)
        and not any(part._forward_hooks or part._forward_pre_hooks for part in (network, head))
    )
