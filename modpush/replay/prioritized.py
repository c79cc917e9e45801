"""`PrioritizedSampler`: TorchRL's, with trees in NumPy."""

from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor
from torchrl.data import PrioritizedSampler as TorchRLPrioritizedSampler
from torchrl.data.replay_buffers.storages import Storage

from modpush._checks import check_keys
from modpush._state import SavedState
from modpush._types import Count, NonNegative, NonNegativeInteger, Positive
from modpush._validation import check_value, checked_arguments

_MaxPriority = tuple[NonNegative, NonNegativeInteger] | None


class PrioritizedSampler(SavedState, TorchRLPrioritizedSampler):
    """TorchRL's `PrioritizedSampler` without its C++ extension, which not every torch loads.

    An entry of priority p is drawn, with replacement, with probability (p + eps)^alpha over the sum
    of all. The sample's info holds `"priority_weight"` `[batch]`, the importance weight
    (N * probability)^-beta divided by the largest in the buffer. A new entry has the largest
    priority that was ever given, 1 at first. NumPy's global generator draws, unless the buffer has
    a generator of its own.

    Args:
        max_capacity: Number of entries that the buffer holds.
        alpha: Exponent of the priorities; 0 is uniform sampling.
        beta: Exponent of the importance weights.
        eps: Added to each priority, so that every entry may be drawn.

    Raises:
        ValueError: If an argument is out of range. In `update_priority`: if a priority is negative or
            not finite.

    Source: Schaul et al. (2016), "Prioritized Experience Replay", proportional variant.
    """

    state_file = "prioritized_sampler.safetensors"
    _max_priority: Any  # TorchRL's property of (priority, index)

    @checked_arguments
    def __init__(
        self,
        max_capacity: Count,
        alpha: NonNegative,
        beta: NonNegative,
        eps: Positive = 1e-8,
    ) -> None:
        # Not TorchRL's, which warns that the extension is missing.
        self._max_capacity, self._alpha, self._beta, self._eps = max_capacity, alpha, beta, eps
        self.reduction, self.dtype = "max", torch.float64
        self._max_priority_within_buffer = False
        self._device = torch.device("cpu")
        self._init()

    def _init(self) -> None:
        self._sum_tree = _Tree(self._max_capacity, np.add, 0.0)
        self._min_tree = _Tree(self._max_capacity, np.minimum, np.inf)
        self._max_priority: tuple[Tensor, Tensor] | None = None

    def sample(self, storage: Storage, batch_size: int) -> tuple[Any, dict[str, Any]]:
        """Draw a batch: its index, and its importance weights as float32."""
        index, info = super().sample(storage, batch_size)
        return index, {"priority_weight": info["priority_weight"].float()}

    def update_priority(
        self, index: int | Tensor, priority: float | Tensor, *, storage: Storage | None = None
    ) -> None:
        """Set the priorities of some entries.

        Args:
            index: `[n]`.
            priority: `[n]`, or one number for all of them.
            storage: The storage, for TorchRL.
        """
        priority = torch.as_tensor(priority, dtype=torch.float64, device="cpu").detach()
        if not ((priority >= 0) & priority.isfinite()).all():
            raise ValueError(
                "PrioritizedSampler: priority must be finite and >= 0, got "
                f"{priority.flatten().tolist()[:8]}."
            )
        index = torch.as_tensor(index, dtype=torch.long, device="cpu")
        super().update_priority(index, priority, storage=storage)

    def state_dict(self) -> dict[str, Any]:
        """Exponents and priorities, as plain data and tensors."""
        largest, where = self._max_priority or (None, None)
        return {
            "alpha": self._alpha,
            "beta": self._beta,
            "eps": self._eps,
            "max_priority": None
            if largest is None or where is None
            else (float(largest), int(where)),
            "weights": torch.from_numpy(self._sum_tree.leaves.copy()),
        }

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Continue where the other sampler was.

        Raises:
            ValueError: If the state is that of another kind of sampler, or of another capacity.
        """
        check_keys(state_dict, self.state_dict())
        weights = torch.as_tensor(state_dict["weights"], dtype=torch.float64)
        if weights.shape != (self._max_capacity,) or not (weights >= 0).all():
            raise ValueError(
                f"weights must be {self._max_capacity} numbers >= 0, the capacity, got shape "
                f"{list(weights.shape)}."
            )
        alpha, beta = (check_value(k, state_dict[k], NonNegative) for k in ("alpha", "beta"))
        eps = check_value("eps", state_dict["eps"], Positive)
        largest = check_value("max_priority", state_dict["max_priority"], _MaxPriority)
        self._alpha, self._beta, self._eps = alpha, beta, eps
        self._init()
        written = weights.nonzero().flatten()
        self._sum_tree[written] = self._min_tree[written] = weights[written]
        if largest is not None:
            value, where = (torch.tensor(part, device="cpu") for part in largest)
            self._max_priority = value, where


class _Tree:
    """Sums or minima of numbers in a binary tree, with the methods of TorchRL's compiled trees.

    Node i has the children 2i and 2i + 1; the numbers are the last layer.
    """

    def __init__(self, capacity: int, combine: np.ufunc, neutral: float) -> None:
        self._capacity, self._layers = capacity, (capacity - 1).bit_length()
        self._first = 1 << self._layers
        self._nodes: NDArray[np.float64] = np.full(2 * self._first, neutral)
        self._combine, self._neutral = combine, neutral

    @property
    def leaves(self) -> NDArray[np.float64]:
        """The numbers, `[capacity]`, not a copy."""
        return self._nodes[self._first :][: self._capacity]

    def __getitem__(self, index: ArrayLike) -> Tensor:
        return torch.as_tensor(self.leaves[np.asarray(index)])

    def __setitem__(self, index: ArrayLike, value: ArrayLike) -> None:
        self.leaves[np.asarray(index)] = value
        node = self._first + np.asarray(index)
        for _ in range(self._layers):
            node = node // 2
            self._nodes[node] = self._combine(self._nodes[2 * node], self._nodes[2 * node + 1])

    def query(self, left: int, right: int) -> float:
        """The sum or minimum of the numbers from `left` to before `right`."""
        result, left, right = self._neutral, left + self._first, right + self._first
        while left < right:
            if left % 2:
                result, left = self._combine(result, self._nodes[left]), left + 1
            if right % 2:
                right -= 1
                result = self._combine(result, self._nodes[right])
            left, right = left // 2, right // 2
        return float(result)

    def scan_lower_bound(self, mass: ArrayLike) -> Tensor:
        """For each mass the number at which the sum from the left exceeds it."""
        rest = torch.as_tensor(mass, dtype=torch.float64).numpy().copy()
        node = np.ones(rest.shape, dtype=np.int64)
        for _ in range(self._layers):
            node *= 2
            left = self._nodes[node]
            beyond = rest >= left
            rest -= np.where(beyond, left, 0.0)
            node += beyond
        return torch.as_tensor(node - self._first)
