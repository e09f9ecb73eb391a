"""One training run on several processes: data-parallel training, as ``torchrun`` starts it.

.. code-block:: sh

    torchrun --nproc-per-node 2 -m tutorial_lib train aclstm --data samples/walking --out walk.safetensors

Every process has the whole network and draws the whole of each batch from the same seed, takes its share of the
sequences, and computes the loss on those. As every loss is a mean over sequences, the mean of the shares' gradients
is the gradient of the whole batch. What a loss draws (noise, schedules, dropout, Gibbs chains) is drawn for the whole
batch, too, and cut likewise, so that N processes train to the weights of one but for the rounding of sums.

PyTorch's ``DistributedDataParallel`` is not used: it averages what runs through ``model(...)``, while the
rollout engine and the stages of the Dynamic Future Net call parts of a network.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, TypeVar

import torch
import torch.distributed
from torch import Tensor, nn
from torch.nn.functional import dropout
from torch.overrides import TorchFunctionMode

from ..errors import TutorialError

T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class Workers:
    """The processes that train one network together; by default this one alone, and then nothing is changed.

    rank: the number of this process, from 0. count: how many there are.
    """

    rank: int = 0
    count: int = 1

    @property
    def first(self) -> bool:
        """Whether this process is the one that writes and prints."""
        return self.rank == 0

    def share(self, batch: Any) -> Any:
        """This process's part of a batch: tensors (B, ...), or tuples, lists or dicts of them, to (B / count, ...).

        Raises :class:`TutorialError` where B is not a multiple of the number of processes.
        """
        if self.count == 1:
            return batch
        if isinstance(batch, Tensor):
            self.check_batch(len(batch))
            return batch[self._mine(len(batch))]
        if isinstance(batch, Mapping):
            return {name: self.share(value) for name, value in batch.items()}
        if isinstance(batch, (tuple, list)):
            return type(batch)(self.share(value) for value in batch)
        return batch

    def _mine(self, rows: int) -> slice:
        size = rows // self.count
        return slice(self.rank * size, (self.rank + 1) * size)

    def check_batch(self, size: int) -> None:
        """Raise :class:`TutorialError` unless a batch of that size can be shared evenly."""
        if size % self.count:
            raise TutorialError(
                f"a batch of {size} windows cannot be shared evenly by {self.count} processes: expected a multiple "
                f"of {self.count}"
            )

    def drawing(self) -> contextlib.AbstractContextManager:
        """Inside the block, random numbers for this process's share are its part of those for the whole batch."""
        return contextlib.nullcontext() if self.count == 1 else _WholeBatchDraws(self)

    def average_gradients(self, parameters: Iterable[nn.Parameter]) -> None:
        """Every process gets the mean of all processes' gradients."""
        if self.count == 1:
            return
        gradients = [p.grad for p in parameters if p.grad is not None]
        flat = self.average(torch.cat([gradient.flatten() for gradient in gradients]))
        for gradient, mean in zip(gradients, flat.split([g.numel() for g in gradients]), strict=True):
            gradient.copy_(mean.view_as(gradient))

    def average(self, values: Tensor) -> Tensor:
        """The mean over all processes, the same on each of them to the last bit."""
        if self.count == 1:
            return values
        values = values.detach().clone()
        with _lost_workers():
            torch.distributed.all_reduce(values)
        return values / self.count

    def any(self, said: bool) -> bool:
        """Whether any process says so: all stop after the same step, or none does."""
        if self.count == 1:
            return said
        return bool(self.average(torch.tensor(float(said))) > 0)

    def same_weights(self, model: nn.Module) -> None:
        """Every process gets the first one's weights and buffers, should other hardware have drawn others."""
        if self.count == 1:
            return
        with torch.no_grad(), _lost_workers():
            for value in (*model.parameters(), *model.buffers()):
                torch.distributed.broadcast(value, src=0)

    def together(self, work: Callable[[], T]) -> T:
        """``work()`` on every process; an error of one is raised on all, so that none waits for it for ever."""
        if self.count == 1:
            return work()
        result, mine = None, None
        try:
            result = work()
        except (TutorialError, OSError) as error:
            mine = error
        told: list[str | None] = [None] * self.count
        with _lost_workers():
            torch.distributed.all_gather_object(told, None if mine is None else str(mine))
        for rank, text in enumerate(told):
            if text is not None:
                raise mine if rank == self.rank else TutorialError(f"process {rank}: {text}")
        return result

    def device(self, name: str) -> str:
        """The device for this process: of several graphics cards each process takes its own."""
        if self.count > 1 and name == "cuda":
            return f"cuda:{os.environ.get('LOCAL_RANK', 0)}"
        return name


def workers() -> Workers:
    """The processes that were joined (:func:`joined`, or torch.distributed by other means), else this one alone."""
    if torch.distributed.is_available() and torch.distributed.is_initialized():
        return Workers(torch.distributed.get_rank(), torch.distributed.get_world_size())
    return Workers()


@contextlib.contextmanager
def joined() -> Iterator[Workers]:
    """Join the other processes that ``torchrun`` started; without it, this process is alone and nothing happens.

    Inside the block only the first process prints; an error that all of them meet is told by that one, the others
    end with status 2.
    """
    if int(os.environ.get("WORLD_SIZE", 1)) <= 1:
        yield Workers()
        return
    mine = not torch.distributed.is_initialized()
    if mine:
        torch.distributed.init_process_group()  # by MASTER_ADDR, RANK, ...: gloo on the CPU, nccl on graphics cards
    try:
        own = workers()
        if own.first:
            yield own
            return
        with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere), contextlib.redirect_stderr(nowhere):
            try:
                yield own
            except (TutorialError, OSError):
                raise SystemExit(2) from None
    finally:
        if mine:
            torch.distributed.destroy_process_group()


@contextlib.contextmanager
def _lost_workers() -> Iterator[None]:
    try:
        yield
    except RuntimeError as error:
        reason = str(error).splitlines()[0][:160]
        raise TutorialError(f"lost a process that was training the same network ({reason}); see what it told") from None


# What draws random numbers and is not cut to shares below; in a loss that uses it, processes would go apart.
_NOT_SHARED = frozenset(
    [torch.rand_like, torch.randn_like, torch.randint, torch.randperm, torch.bernoulli, torch.multinomial, torch.normal]
    + [getattr(Tensor, name) for name in ("normal_", "uniform_", "bernoulli_", "random_", "bernoulli", "multinomial")]
)


class _WholeBatchDraws(TorchFunctionMode):
    """``torch.rand``, ``torch.randn`` and dropout for a share: drawn for the whole batch, then cut.

    The first axis of what is drawn must be the batch, or the batch and others flattened into one.
    """

    def __init__(self, workers: Workers):
        super().__init__()
        self._workers = workers

    def __torch_function__(self, function, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        if function in (torch.rand, torch.randn):
            size = args[0] if len(args) == 1 and not isinstance(args[0], int) else args
            whole = function(self._whole(size), **kwargs)
            return whole[self._workers._mine(len(whole))]
        if function is dropout:
            return self._dropout(*args, **kwargs)
        if function in _NOT_SHARED:
            raise TutorialError(
                f"the loss draws with {function.__name__}, which cannot be shared by processes: expected torch.rand, "
                "torch.randn or dropout, with the batch as first axis"
            )
        return function(*args, **kwargs)

    def _whole(self, size: Any) -> tuple[int, ...]:
        return (size[0] * self._workers.count, *size[1:])

    def _dropout(self, x: Tensor, p: float = 0.5, training: bool = True, inplace: bool = False) -> Tensor:
        if not training or p == 0:
            return x
        kept = dropout(torch.ones(self._whole(x.shape), dtype=x.dtype, device=x.device), p)
        return x * kept[self._workers._mine(len(kept))]
