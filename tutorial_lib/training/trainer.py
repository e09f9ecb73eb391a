"""One training loop for every system: progress, checkpoints, and resuming to the very same weights."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
import pathlib
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

import torch
from torch import Tensor, nn

from ..chance import check_whole, seeded, whole_seed
from ..errors import CheckpointError, TutorialError
from .checkpoints import load_state, provenance, save_checkpoint
from .parallel import workers
from .progress import LivePlot, Progress
from .stages import Stage, stage_ends
from .systems import System

SCHEDULES = ("one-cycle", "constant")


class TrainingError(TutorialError):
    """Training that cannot go on: a loss or gradient that is not finite."""


class Batches(Protocol):
    """Where training gets its batches from, such as :class:`tutorial_lib.data.windows.WindowSampler`."""

    def sample(self) -> Any:
        """The next batch: a tensor, or a tuple, list or dict of tensors."""

    def state_dict(self) -> dict[str, Any]:
        """All that decides which batches come next."""

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on where the sampler was when ``state`` was taken."""


@dataclasses.dataclass(frozen=True)
class TrainingConfig:
    """How a system is trained. The paper (acRNN, section 3): Adam, 1e-4, 500,000 steps, constant.

    The defaults are for minutes on a CPU instead of days on a GPU: twenty times the learning rate along
    a one-cycle schedule, and a bound on the gradient's norm.
    """

    steps: int = 2500
    learning_rate: float = 2e-3
    schedule: str = "one-cycle"  # or "constant"
    clip: float | None = 1.0  # largest norm of the whole gradient; None: unbounded
    seed: int = 0  # of whatever the loss draws; weights and batches have their own

    def __post_init__(self):
        check_whole("steps", self.steps)
        # plain numbers, for the header of a checkpoint
        object.__setattr__(self, "steps", int(self.steps))
        object.__setattr__(self, "seed", whole_seed(self.seed))
        if not (self.learning_rate > 0 and math.isfinite(self.learning_rate)):
            raise TutorialError(f"the learning rate must be above 0 and finite, not {self.learning_rate!r}")
        if self.schedule not in SCHEDULES:
            raise TutorialError(f"unknown schedule {self.schedule!r}; known are {', '.join(SCHEDULES)}")
        if self.clip is not None and not self.clip > 0:
            raise TutorialError(f"clip must be above 0 or None, not {self.clip!r}")

    def learning_rate_at(self, step: int, steps: int | None = None) -> float:
        """Learning rate of step 0 ... steps - 1; of a stage of a run, ``steps`` are its own.

        "one-cycle" (Smith and Topin, "Super-convergence", 2017): half a cosine up from 1/25 of the full rate
        over the first 30 % of the steps, half a cosine down to nearly nothing over the rest.
        """
        if self.schedule == "constant":
            return self.learning_rate
        low, high, end = self.learning_rate / 25, self.learning_rate, self.learning_rate / 250_000
        progress = step / max(1, (self.steps if steps is None else steps) - 1)
        if progress < 0.3:
            return low + (high - low) * (1 - math.cos(math.pi * progress / 0.3)) / 2
        return end + (high - end) * (1 + math.cos(math.pi * (progress - 0.3) / 0.7)) / 2


class Trainer:
    """Trains a :class:`System` on batches; can be stopped, killed and resumed at any step.

    >>> system = make_system("lstm", dim=representation.dim, hidden=128, seed=1)
    >>> trainer = Trainer(system, sampler, TrainingConfig(steps=2500), path="lstm.safetensors")
    >>> trainer.run()
    >>> trainer.history["loss"]

    Parameters
    ----------
    system : network and loss, or its stages: each then has its share of the steps, a learning rate that
        starts anew, and a line of progress of its own, and only its part of the network learns.
        Parameters that do not require gradients stay as they are.
    batches : gives the batches, see :class:`Batches`.
    config : steps, learning rate and so on.
    path : the checkpoint to write, every ``save_seconds`` and at the end; ``None`` writes nothing.
    representation, normalizer : what the checkpoint needs to turn features into motion; by default those of
        ``batches``, if it has them.
    provenance : what :func:`tutorial_lib.training.checkpoints.provenance` makes.
    sway : the gait of the clips, kept in the checkpoint (:mod:`tutorial_lib.control.sway`).
    device : where the network is trained. The CPU is the reference: there a resumed run gives the weights of
        an uninterrupted one bit for bit (with the same number of threads).
    settings : further values to keep in the checkpoint's ``training`` (batch, length, ...), not interpreted.

    Where ``torchrun`` has started several processes that are joined (:mod:`.parallel`), each of them makes its trainer
    in the same way; together they train one network, each on its share of every batch, and the first one writes.

    Nothing global is changed: what the loss draws comes from a generator of the trainer's own, and
    torch's global generator (which dropout uses) is set inside :meth:`run` only and put back after it.
    """

    def __init__(
        self,
        system: System,
        batches: Batches,
        config: TrainingConfig | None = None,
        *,
        path: str | os.PathLike | None = None,
        representation: Any = None,
        normalizer: Any = None,
        provenance: Mapping[str, Any] | None = None,
        sway: Any = None,
        device: str | torch.device = "cpu",
        save_seconds: float = 60.0,
        settings: Mapping[str, Any] | None = None,
    ):
        self.system, self.batches = system, batches
        self.config = config or TrainingConfig()
        self.path = None if path is None else pathlib.Path(path)
        self.device = usable_device(device)
        self.save_seconds = save_seconds
        self.settings = {**system.options, **(settings or {})}
        self.step = 0  # steps done
        self.history: dict[str, list[float]] = {"loss": []}  # and the loss's named terms
        self.seconds = 0.0  # spent in training, over all runs
        self._representation = getattr(batches, "representation", None) if representation is None else representation
        self._normalizer = getattr(batches, "normalizer", None) if normalizer is None else normalizer
        self._provenance, self.sway = provenance, sway
        self._stopped = ""  # why, if it is for good
        self.stages = system.stages or (Stage(system.name, system.loss),)
        self._ends = stage_ends(self.stages, self.config.steps)

        self.model.to(self.device)
        self._parameters = [p for p in self.model.parameters() if p.requires_grad]
        if not self._parameters:  # as load_checkpoint hands a network out
            raise TutorialError(
                f"no parameter of the network of system {system.name!r} requires a gradient, expected one or more: "
                "model.requires_grad_(True) lets all be trained"
            )
        fused = self.device.type in ("cpu", "cuda")  # the same numbers, three times as fast on a CPU
        self._optimizer = torch.optim.Adam(self._parameters, lr=self.config.learning_rate, fused=fused)
        self._rng = seeded(self.config.seed)
        self._global_rng = {"cpu": seeded(self.config.seed).get_state()}
        self._good: list[Tensor] | None = None
        self._workers = workers()
        if isinstance(size := getattr(batches, "batch", None), int):
            self._workers.check_batch(size)

    @property
    def model(self) -> nn.Module:
        """The network that is trained."""
        return self.system.model

    @property
    def finished(self) -> bool:
        """Whether all steps are done."""
        return self.step >= self.config.steps

    @property
    def stage(self) -> Stage:
        """The stage of the next step; when all are done the last."""
        return self.stages[self._stage]

    @property
    def _stage(self) -> int:
        return min(sum(self.step >= end for end in self._ends), len(self.stages) - 1)

    def stage_steps(self, stage: int) -> range:
        """The steps of a stage, counted from 0."""
        return range(self._ends[stage - 1] if stage else 0, self._ends[stage])

    def stage_history(self, name: str) -> dict[str, list[float]]:
        """The loss and its terms at the steps done of the stage of that name; unknown names raise ``TutorialError``."""
        names = [stage.name for stage in self.stages]
        if name not in names:
            raise TutorialError(f"no stage {name!r} in this run; it has {', '.join(names)}")
        steps = self.stage_steps(names.index(name))
        parts = {term: values[steps.start : steps.stop] for term, values in self.history.items()}
        return {term: values for term, values in parts.items() if not all(math.isnan(v) for v in values)}

    @property
    def loss(self) -> float | None:
        """The mean loss of the last hundred steps, of one stage; ``None`` before the first."""
        start = max((steps.start for k in range(len(self.stages)) if (steps := self.stage_steps(k)).start < self.step),
                    default=0)  # fmt: skip
        recent = self.history["loss"][start:][-100:]
        return sum(recent) / len(recent) if recent else None

    def __repr__(self) -> str:
        loss = "" if self.loss is None else f", loss {self.loss:.4g}"
        return f"Trainer({self._title}: {self.step} of {self.config.steps} steps{loss})"

    @property
    def _title(self) -> str:
        if len(self.stages) == 1:
            return self.system.name
        return f"{self.system.name}, {self.stage.name} ({self._stage + 1} of {len(self.stages)})"

    def run(
        self,
        *,
        progress: bool = True,
        live_plot: bool = True,
        callback: Callable[[Trainer], None] | None = None,
        max_seconds: float | None = None,
    ) -> Trainer:
        """Train until all steps are done, and return the trainer itself.

        Ctrl-C, a notebook's stop button and ``max_seconds`` end it after the step that is under way, with
        everything saved; a second Ctrl-C ends it at once. Called again, it goes on from where it was.

        Parameters
        ----------
        progress : show a line with the loss and steps a second (standard error, or a notebook's output).
        live_plot : in a notebook, draw the loss so far; elsewhere nothing happens.
        callback : called after every step with the trainer.
        max_seconds : stop after so many seconds of wall time.

        Raises
        ------
        TrainingError : if the loss or its gradient is not finite. The network, and the checkpoint, then hold
            the last weights whose loss and gradient were.
        """
        if self._stopped:
            raise TrainingError(f"training has stopped for good: {self._stopped}")
        if self.finished:
            return self
        start = last_save = time.monotonic()
        before = self.seconds
        bar = plot = None
        progress, live_plot = progress and self._workers.first, live_plot and self._workers.first
        self._workers.same_weights(self.model)
        required = [(parameter, parameter.requires_grad) for parameter in self.model.parameters()]
        try:
            with self._own_global_rng(), _deferred_interrupt() as interrupt:
                while not self.finished:
                    if bar is None:
                        self._enter_stage()
                        steps = self.stage_steps(self._stage)
                        bar = Progress(len(steps), start=self.step - steps.start, title=self._title, enabled=progress)
                        plot = LivePlot(len(steps), title=self._title, enabled=live_plot)
                        shown, losses = None, self.history["loss"][steps.start :]
                    loss = self._train_step()
                    now = time.monotonic()
                    self.seconds = before + now - start
                    shown = loss if shown is None else 0.95 * shown + 0.05 * loss
                    bar.update(loss=shown)
                    losses.append(loss)
                    plot.update(losses)
                    ended = self.step == steps.stop
                    if ended:
                        self._leave_stage()
                        bar.close()
                        plot.close(losses)
                        bar = None
                    if callback is not None:
                        self._remember_global_rng()  # it may save
                        callback(self)
                        self.model.train()  # it may have generated something
                    over = max_seconds is not None and now - start >= max_seconds
                    if self._workers.any(bool(interrupt) or over):
                        break
                    if not self.finished and (ended or now - last_save >= self.save_seconds):
                        self._remember_global_rng()
                        self.save()
                        last_save = time.monotonic()
        except TrainingError as error:
            if self.path is not None and self.step > 0:
                self.save()
                raise TrainingError(f"{error} in {self.path}") from None
            raise
        finally:
            if bar is not None:
                bar.close()
                plot.close(losses)
            for parameter, requires_grad in required:  # stages have changed it; another trainer goes by it
                parameter.requires_grad_(requires_grad)
            self.model.eval()
        self.save()
        return self

    def _enter_stage(self) -> None:
        """The part of the network that learns in the stage of the next step, and no other, takes gradients."""
        stage = self.stage
        if self.step == self.stage_steps(self._stage).start:
            if stage.check is not None:
                stage.check(self.model)
            if stage.before is not None:
                stage.before(self.model, self._sample)
        if stage.module:
            for name, parameter in self.model.named_parameters():
                parameter.requires_grad_(name.startswith(stage.module + "."))
        self.model.train()

    def _leave_stage(self) -> None:
        """After the last step of a stage."""
        if not all(torch.isfinite(p).all() for p in self._parameters):
            self._stop("largest weight after the update", math.inf, self.step)
        stage = self.stages[self._ends.index(self.step)]
        if stage.after is not None:
            stage.after(self.model, self._sample)
        self._good = None  # what follows must not undo a step of this stage

    def _sample(self) -> Any:
        """The next batch, on the device."""
        return _to_device(self.batches.sample(), self.device)

    def _train_step(self) -> float:
        """One step of gradient descent; returns the loss. Nothing changes if it is not finite."""
        config, steps = self.config, self.stage_steps(self._stage)
        done = self.step - steps.start  # of this stage
        share = self._workers.share(self._sample())
        with self._workers.drawing():
            result = self.stage.loss(self.model, share, self._rng, done / max(1, len(steps) - 1))
        loss, terms = result if isinstance(result, tuple) else (result, {})
        self._optimizer.zero_grad(set_to_none=True)
        loss.backward()
        self._workers.average_gradients(self._parameters)
        norm = nn.utils.clip_grad_norm_(self._parameters, config.clip or math.inf)
        values = torch.stack([loss.detach(), norm, *(term.detach() for term in terms.values())])
        values = self._workers.average(values).tolist()
        if not (math.isfinite(values[0]) and math.isfinite(values[1])):
            self._stop(
                "loss" if not math.isfinite(values[0]) else "gradient's norm",
                values[0] if not math.isfinite(values[0]) else values[1],
            )
        self._keep_good_weights()
        for group in self._optimizer.param_groups:
            group["lr"] = config.learning_rate_at(done, len(steps))
        self._optimizer.step()
        self.step += 1
        told = dict(zip(["loss", *terms], [values[0], *values[2:]], strict=True))
        for name in {**self.history, **told}:  # a term that another stage has is not a number in this one
            self.history.setdefault(name, [math.nan] * (self.step - 1)).append(told.get(name, math.nan))
        return values[0]

    def _keep_good_weights(self) -> None:
        """A copy of the weights that just gave a finite loss and gradient, to fall back on."""
        with torch.no_grad():
            if self._good is None:
                self._good = [p.detach().clone() for p in self._parameters]
            else:
                for kept, parameter in zip(self._good, self._parameters, strict=True):
                    kept.copy_(parameter)

    def _stop(self, what: str, value: float, failed: int | None = None) -> None:
        failed = self.step + 1 if failed is None else failed
        if self._good is not None:  # the last update led here: it is undone
            with torch.no_grad():
                for parameter, good in zip(self._parameters, self._good, strict=True):
                    parameter.copy_(good)
            self.step -= 1
            for values in self.history.values():
                del values[self.step :]
        kept = f"the last good weights, of step {self.step}, are kept" if self.step else "nothing was learnt"
        self._stopped = f"the {what} of step {failed} was {value}"
        raise TrainingError(
            f"training stopped: {self._stopped} (learning rate {self.config.learning_rate:g}; "
            f"a smaller one may help); {kept}"
        )

    def save(self, *, half: bool = False) -> None:
        """Write the checkpoint now; an unfinished one carries what :meth:`resume` needs."""
        if self.path is None or not self._workers.first:
            return
        unfinished = not self.finished and not self._stopped
        status = self._stopped or ("unfinished" if unfinished else "finished")
        training = {
            **self.settings,
            **dataclasses.asdict(self.config),
            "steps_done": self.step,
            "status": status,
            "seconds": round(self.seconds, 1),
            "device": str(self.device),
            "loss": self.loss,
        }
        save_checkpoint(
            self.path,
            system=self.system.name,
            model=self.model,
            representation=self._representation,
            normalizer=self._normalizer,
            training=training,
            provenance=self._provenance or provenance(),
            sway=self.sway,
            state=self._state() if unfinished else None,
            half=half,
        )

    def resume(self, path: str | os.PathLike | None = None) -> Trainer:
        """Go on with the unfinished run in ``path`` (by default the trainer's own), from its last save.

        The trainer must have been made as that run's was. What is given back is exact: weights, optimiser,
        generators, place in the data and loss history; on the CPU the run ends in the same weights, bit
        for bit, as one that was never interrupted.

        Raises :class:`CheckpointError` if the file has no training state or belongs to another run.
        """
        path = self.path if path is None else path
        if path is None:
            raise CheckpointError("nothing to resume from: the trainer has no path")
        header, weights, state = load_state(path)
        training = header.get("training", {})
        mine = {
            "system": self.system.name,
            **dataclasses.asdict(self.model.config),
            **self.settings,
            **dataclasses.asdict(self.config),
        }
        theirs = {"system": header["system"], **header.get("model", {}), **training}
        features = None if self._representation is None else self._representation.config()
        if header.get("representation") != features:
            raise CheckpointError(f"{path}: cannot be resumed with features of another representation or skeleton")
        for name, value in mine.items():
            if _plain(theirs.get(name)) != _plain(value):
                raise CheckpointError(
                    f"{path}: cannot be resumed with {name} {value!r}: it was started with {theirs.get(name)!r}"
                )
        try:
            self.model.load_state_dict(weights)
            self._optimizer.load_state_dict(state["optimizer"])
            self._rng.set_state(state["rng"])
            self._global_rng = dict(state["global_rng"])
            self.batches.load_state_dict(state["batches"])
            self.history = {name: values.tolist() for name, values in state["history"].items()}
            self.step, self.seconds = int(training["steps_done"]), float(training["seconds"])
        except (KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
            raise CheckpointError(
                f"{path}: does not fit this training run ({' '.join(str(error).split())[:160]})"
            ) from None
        return self

    def _state(self) -> dict[str, Any]:
        return {
            "optimizer": self._optimizer.state_dict(),
            "rng": self._rng.get_state(),
            "global_rng": self._global_rng,
            "batches": self.batches.state_dict(),
            "history": {name: torch.tensor(values, dtype=torch.float64) for name, values in self.history.items()},
        }

    @contextlib.contextmanager
    def _own_global_rng(self) -> Iterator[None]:
        cuda = [self.device.index or 0] if self.device.type == "cuda" else []
        with torch.random.fork_rng(devices=cuda):
            torch.set_rng_state(self._global_rng["cpu"])
            if cuda:
                if "cuda" in self._global_rng:
                    torch.cuda.set_rng_state(self._global_rng["cuda"], cuda[0])
                else:
                    with torch.cuda.device(cuda[0]):
                        torch.cuda.manual_seed(self.config.seed)
            try:
                yield
            finally:
                self._remember_global_rng()

    def _remember_global_rng(self) -> None:
        self._global_rng = {"cpu": torch.get_rng_state()}
        if self.device.type == "cuda":
            self._global_rng["cuda"] = torch.cuda.get_rng_state(self.device.index or 0)


def usable_device(device: str | torch.device) -> torch.device:
    """The device of that name, if it exists and this build of torch can compute on it."""
    try:
        device = torch.device(device)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise TutorialError(f"cannot compute on device {str(device)!r}: {reason[:160]}") from None
    if device.type == "meta":
        raise TutorialError("cannot compute on device 'meta': it has no numbers")
    return device


def _to_device(batch: Any, device: torch.device) -> Any:
    if isinstance(batch, Tensor):
        return batch.to(device)
    if isinstance(batch, Mapping):
        return {name: _to_device(value, device) for name, value in batch.items()}
    if isinstance(batch, (tuple, list)):
        return type(batch)(_to_device(value, device) for value in batch)
    return batch


def _plain(value: Any) -> Any:
    """As JSON would give it back."""
    return [_plain(v) for v in value] if isinstance(value, (tuple, list)) else value


@contextlib.contextmanager
def _deferred_interrupt() -> Iterator[list[int]]:
    """Ctrl-C inside the block is noted in the list that it gives, so that no step is left half done.

    A second one interrupts at once. Outside the main thread, where no signal arrives, nothing is changed.
    """
    caught: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield caught
        return

    def note(number, frame):
        if caught:
            raise KeyboardInterrupt
        caught.append(number)

    previous = signal.signal(signal.SIGINT, note)
    try:
        yield caught
    finally:
        signal.signal(signal.SIGINT, previous)
