"""Recipes: everything that decides what a training run gives, in one small value; and the run itself from it.

>>> recipe = Recipe("aclstm", ("cmu/salsa", "cmu/indian"), steps=10_000, options={"u": 5, "v": 5})
>>> trainer = trainer_for(recipe, "hybrid.safetensors")     # new, resumed or finished, as the file says
>>> trainer.run()

The ``train`` command is this and a parser. It takes its defaults from here, also for its help, so torch is
imported by the functions that need it and not with the module.
"""

from __future__ import annotations

import dataclasses
import math
import os
import pathlib
import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from .errors import CheckpointError, DataError, MotionError, TutorialError

if TYPE_CHECKING:
    from .control.sway import Sway
    from .motion.clip import Motion
    from .motion.skeleton import Skeleton
    from .training.checkpoints import Checkpoint
    from .training.systems import System
    from .training.trainer import Trainer

# What a run is where neither it nor its system says otherwise.
DEFAULTS: Mapping[str, Any] = {
    "representation": "positions", "length": 100, "joints": "own", "pad": False, "rotate": True, "steps": 2500,
}  # fmt: skip
NORMALIZE = ("auto", "on", "off")
JOINTS = ("own", "common")
JOINED_SECONDS = 600.0  # of clips, before the joins cut them


@dataclasses.dataclass(frozen=True)
class Recipe:
    """All that decides what a training run gives: two runs of one recipe give the same weights.

    (On the CPU bit for bit, with the same number of threads.) The defaults are for a CPU's minutes; the acRNN
    paper has 1024 cells and 500,000 steps at a constant rate of 1e-4. What is ``None`` by default is the system's:
    :data:`DEFAULTS` but for the VAE-LSTM, the cRBM and the Dynamic Future Net, see their entries in
    :data:`tutorial_lib.training.systems.SYSTEMS`.

    Everything is checked when the value is made: a :class:`TutorialError` in one line says what cannot be.
    """

    system: str  # name in tutorial_lib.training.systems.SYSTEMS
    data: tuple[str, ...]  # data sets, or folders or files; several: hybrid training on all of them together
    representation: str | None = None
    fps: float = 30.0
    height: float | None = 1.54  # metres that every skeleton is scaled to; None (or 0) leaves it
    length: int | None = None  # frames in a training window
    batch: int = 32  # windows in a step
    rates: tuple[float, ...] | None = None  # frame rates at which windows are taken; None: fps
    rotate: bool | None = None  # windows are turned about the vertical at random
    normalize: str = "auto"  # "on", "off", or "auto": all but positions, which the paper takes in metres (cRBM: all)
    test_fraction: float = 0.2  # share of each data set's clips that is kept out; 0: none
    joints: str | None = None  # "common": every clip is mapped to the 21 common joints first; "own": it is not
    pad: bool | None = None  # clips shorter than a window are lengthened with their first and last pose
    join: float = 0.0  # seconds of blending between training clips that follow one another without end; 0: each ends
    mirror: bool = False  # every training clip is also learnt from in its mirror image, left and right exchanged
    hidden: int = 128
    layers: int | None = None  # None: as many as the system has by default (LSTM-3LR 3, ERD 2, seq2seq 1, VAE-LSTM -)
    steps: int | None = None
    learning_rate: float = 2e-3
    schedule: str = "one-cycle"
    clip: float | None = 1.0
    start: str | None = None  # a checkpoint with whose weights training begins; None: with random ones
    seed: int = 0  # of weights, windows and the split into training and test clips
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict, hash=False)  # the system's own: u, v, ...

    def __post_init__(self):
        from .representations import REPRESENTATIONS
        from .training.systems import system_kind
        from .training.trainer import TrainingConfig

        kind = system_kind(self.system)
        for name in self.options:
            if name not in kind.options:
                known = f"it has {', '.join(kind.options)}" if kind.options else "it has none"
                raise TutorialError(f"{name!r} is not an option of system {self.system!r}; {known}")
        sizes = {field.name: field.default for field in dataclasses.fields(kind.config)}
        for name, default in {**DEFAULTS, **kind.recipe}.items():
            if getattr(self, name) is None:
                self._set(name, default)
        self._set("data", (self.data,) if isinstance(self.data, str) else tuple(self.data))
        self._set("rates", None if self.rates is None else tuple(self.rates))
        self._set("height", self.height or None)
        if self.layers is not None and "layers" not in sizes:
            raise TutorialError(f"the network of system {self.system!r} has no number of layers to choose")
        self._set("layers", sizes.get("layers") if self.layers is None else self.layers)
        self._set("options", {**kind.options, **self.options})

        if not self.data or not all(isinstance(name, str) and name.strip() for name in self.data):
            raise TutorialError(f"a recipe needs the name of at least one data set, not {list(self.data)}")
        for k, name in enumerate(self.data):
            if name in self.data[:k]:
                raise TutorialError(f"the data set {name!r} is given twice; each has the same share of the windows")
        _one_of("representation", self.representation, tuple(REPRESENTATIONS))
        _one_of("normalize", self.normalize, NORMALIZE)
        _one_of("joints", self.joints, JOINTS)
        for name, rate in (("fps", self.fps), *(("rate", rate) for rate in self.rates or ())):
            if not (rate > 0 and math.isfinite(rate)):
                raise TutorialError(f"{name} must be above 0 and finite, not {rate!r}")
        if self.rates == ():
            raise TutorialError("rates must have one frame rate or more, or be None")
        if self.height is not None and not 0.1 <= self.height <= 10:
            raise TutorialError(f"the height must be between 0.1 and 10 metres, or None, not {self.height!r}")
        if not 0 <= self.test_fraction < 1:
            raise DataError(f"test fraction {self.test_fraction}: expected a number between 0 and 1")
        if not 0 <= self.join <= 10:
            raise TutorialError(f"join must be between 0 and 10 seconds, not {self.join!r}")
        for name, least in (("length", 2), ("batch", 1), ("seed", 0)):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < least:
                raise TutorialError(f"{name} must be a whole number of {least} or more, not {value!r}")
        kind.check_parts(self.system, REPRESENTATIONS[self.representation])
        parts = {part: (k + 1, k + 2) for k, part in enumerate(kind.parts)}  # any, to see whether the sizes can be
        network = kind.config(dim=1 + len(parts), **parts, **self.sizes())
        stride = getattr(network, "stride", 1)
        if self.length % stride:
            raise TutorialError(
                f"system {self.system!r} needs windows of a multiple of {stride} frames, the length is {self.length}"
            )
        TrainingConfig(**self._only(TrainingConfig))
        if kind.reads and self.normalize == "on":
            raise TutorialError(f"system {self.system!r} takes features as they are: normalize 'on' is not for it")
        if kind.normalized and self.normalize == "off":
            raise TutorialError(
                f"system {self.system!r} is made for features of standard deviation 1: normalize 'off' is not for it"
            )
        loss = kind.loss
        if kind.loss_options:
            loss = kind.loss(**{name: self.options[name] for name in kind.loss_options})
        least = max(getattr(part, "least_length", 2) for part in (loss, network))
        if self.length < least:
            raise TutorialError(
                f"system {self.system!r} needs windows of {least} frames with its options "
                f"({', '.join(f'{k} {v}' for k, v in self.options.items())}), the length is {self.length}"
            )
        if getattr(loss, "needs_start", False) and not self.start:
            raise TutorialError(
                f"stage {loss.stage!r} of system {self.system!r} goes on from a checkpoint in which the stages before "
                "it are trained, and none is given to start from (--start)"
            )

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    def _only(self, kind: type) -> dict[str, Any]:
        """Those values that the dataclass ``kind`` has as well."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(kind)}

    def sizes(self) -> dict[str, Any]:
        """What the recipe says of the network's configuration: all but the width and the parts of a frame."""
        from .training.systems import system_kind

        kind = system_kind(self.system)
        values = {"hidden": self.hidden, "layers": self.layers, **self.options}
        return {name: values[name] for name in kind.sizes if name in values}

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it, the system's options beside the rest: what a checkpoint's header holds."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        options = values.pop("options")
        return {name: list(v) if isinstance(v, tuple) else v for name, v in {**values, **options}.items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Recipe:
        """The inverse of :meth:`to_dict`; what is missing has its default. Other names raise ``TutorialError``."""
        from .training.systems import system_kind

        for name in ("system", "data"):
            if not values.get(name):
                raise TutorialError(f"a recipe without {name!r}")
        options = system_kind(values["system"]).options
        fields = [field.name for field in dataclasses.fields(cls) if field.name != "options"]
        for name in values:
            if name not in fields and name not in options:
                raise TutorialError(f"a recipe of system {values['system']!r} has no {name!r}")
        return cls(
            **{name: values[name] for name in fields if name in values},
            options={name: values[name] for name in options if name in values},
        )


def _one_of(name: str, value: str, known: Sequence[str]) -> None:
    if value not in known:
        raise TutorialError(f"unknown {name} {value!r}: expected one of {', '.join(known)}")


def recipe_in(header: Mapping[str, Any]) -> Recipe:
    """The recipe of the run that a checkpoint is from; ``header`` as ``read_header`` gives it.

    Also of files that were written when a run had one data set, whose ``data`` is a plain name.
    Raises :class:`CheckpointError` if the header does not tell.
    """
    from .training.systems import system_kind

    stored = {**header["training"], **header["model"], "system": header["system"]}
    names = [field.name for field in dataclasses.fields(Recipe)]
    names += system_kind(header["system"], CheckpointError).options
    try:
        return Recipe.from_dict({name: stored[name] for name in names if name in stored})
    except (TutorialError, TypeError) as error:
        raise CheckpointError(f"the header does not tell how it was trained ({error})") from None


def differences(asked: Recipe, there: Recipe) -> dict[str, tuple[Any, Any]]:
    """What two recipes do not have in common: {name: (asked, there)}, the system first."""
    one, other = asked.to_dict(), there.to_dict()
    names = dict.fromkeys(("system", *one, *other))
    return {name: (one.get(name), other.get(name)) for name in names if one.get(name) != other.get(name)}


# --- data -----------------------------------------------------------------------------------------


def load_clips(name: str) -> list[Motion]:
    """A named data set, or motion files of the user's own; sorted by name.

    Raises :class:`DataError` for a name that is neither, a data set not at hand, a folder without motion files or
    one that cannot be opened.
    """
    from . import data
    from .data.catalog import read_clip

    if _in_catalogue(name):
        try:
            data.entry(name)
        except DataError as error:
            raise DataError(f"{error}; nor is there such a file or folder") from None
        return data.load(name)
    files, path = _files_of(name), pathlib.Path(name)
    if not files:
        raise DataError(f"{name}: the folder holds no motion file, expected .bvh, or .amc with its .asf")
    # named as the catalogue would, folder and file, so that a clip is known again however it was asked for;
    # of a link to a file it is the link's name
    folder = path if path.is_dir() else path.parent
    root = pathlib.PurePath(folder.resolve().name)
    return [read_clip(f).with_name((root / f.relative_to(folder)).with_suffix("").as_posix()) for f in files]


def _in_catalogue(name: str) -> bool:
    """Whether a name is for the catalogue, which also tells what is wrong with it."""
    from . import data

    return name in data.names() or not pathlib.Path(name).exists()


def _files_of(name: str) -> list[pathlib.Path]:
    """The motion files behind the name of a data set at hand, a folder or a file."""
    from .data.catalog import motion_files, paths_of

    path = pathlib.Path(name)
    if _in_catalogue(name):
        return paths_of(name)
    return motion_files(path) if path.is_dir() else [path]


def sets_of(recipe: Recipe) -> list[tuple[list[Motion], list[Motion]]]:
    """For each data set of the recipe its (training clips, test clips), on the ground and as tall as asked for.

    A data set of a single clip is trained on whole, with a warning. Raises :class:`DataError` for data that is not
    at hand or a clip that is in two data sets, :class:`MotionError` for data sets of different skeletons, or of one
    that has no common joints.
    """
    from .data.windows import split_clips
    from .generate import prepare
    from .motion.retarget import to_common

    loaded = [load_clips(name) for name in recipe.data]
    _check_apart(recipe.data)
    if recipe.joints == "common":
        loaded = [[to_common(motion) for motion in motions] for motions in loaded]
    for name, motions in zip(recipe.data[1:], loaded[1:], strict=True):
        _check_same_skeleton(recipe.data[0], loaded[0][0].skeleton, name, motions[0].skeleton)
    sets = []
    for name, motions in zip(recipe.data, loaded, strict=True):
        motions = prepare(motions, height=recipe.height)
        train, test = motions, []
        if recipe.test_fraction > 0:
            if len(motions) > 1:
                train, test = split_clips(motions, recipe.test_fraction, recipe.seed)
            else:
                of = f"{name}: " if len(recipe.data) > 1 else ""
                warnings.warn(f"{of}a single clip, trained on whole: nothing is kept out for evaluation", stacklevel=2)
        sets.append((train, test))
    return sets


def _check_apart(names: Sequence[str]) -> None:
    """No file may be in two data sets, however they are spelt: kept out of one it would be trained on in the other."""
    taken: dict[tuple[int, int], str] = {}  # by device and number, which links share
    for name in names:
        mine = {}
        for file in _files_of(name):
            status = file.stat()
            key = (status.st_dev, status.st_ino)
            if key in taken:
                raise DataError(
                    f"{file}: is in data set {taken[key]!r} and in {name!r}, each clip may be in one only, "
                    "or it could be kept out and trained on"
                )
            mine[key] = name
        taken |= mine


def _check_same_skeleton(name: str, one: Skeleton, other_name: str, other: Skeleton) -> None:
    if one.same_tree(other):
        return
    mine, theirs = (next((n for n in a.names if n not in b.names), None) for a, b in ((one, other), (other, one)))
    raise MotionError(
        f"data sets of different skeletons: {name} has {one.n_joints} nodes{f', {mine} among them' if mine else ''}, "
        f"{other_name} has {other.n_joints}{f', {theirs} among them' if theirs else ''}; "
        "joints 'common' (--joints common) maps both to the same 21"
    )


def clips_of(recipe: Recipe) -> tuple[list[Motion], list[Motion]]:
    """(Training clips, test clips) of all data sets of a recipe, split in each of them: :func:`sets_of` in one."""
    sets = sets_of(recipe)
    return [m for train, _ in sets for m in train], [m for _, test in sets for m in test]


# --- training -------------------------------------------------------------------------------------


def trainer_for(
    recipe: Recipe,
    path: str | os.PathLike | None = None,
    *,
    device: str = "cpu",
    save_seconds: float = 60.0,
    command: str | None = None,
    resume: bool = True,
    sets: Sequence[tuple[list[Motion], list[Motion]]] | None = None,
) -> Trainer:
    """The trainer of a recipe, at the step where the run in ``path`` is.

    Parameters
    ----------
    path : the checkpoint of the run. If it is not there the run is new; an unfinished run of this recipe is
        resumed; of a finished one the weights are loaded (without the history of its loss), and ``finished`` is
        true. ``None``: nothing is written.
    device, save_seconds : as :class:`Trainer` has them.
    command : kept as the run's origin.
    resume : false starts anew; a file in ``path`` is then replaced at the first save.
    sets : what :func:`sets_of` gave for this recipe, if it is at hand, to spare reading the clips again.

    With several data sets each gives the same share of the windows, whatever its length: in proportion to seconds
    the longest would drown the others.

    Raises :class:`CheckpointError` if ``path`` holds a run of another recipe or of other clips, or one that
    stopped for good; :class:`DataError` and :class:`MotionError` as :func:`sets_of`.
    """
    from .data.windows import Normalizer, WindowSampler
    from .motion.mirror import mirrored
    from .representations import make_representation
    from .training.checkpoints import load_checkpoint, provenance, read_header
    from .training.systems import make_system, system_kind
    from .training.trainer import Trainer, TrainingConfig

    there: Checkpoint | None = None
    if resume and path is not None and os.path.exists(path):
        header = read_header(path)
        for name, (asked, stored) in differences(recipe, _recipe_at(path, header)).items():
            raise CheckpointError(f"{path}: holds a run with {name} {stored!r}, asked for {asked!r}")
        status = header["training"].get("status", "status unknown")
        if not header["resumable"] and status != "finished":
            raise CheckpointError(f"{path}: cannot be resumed, {status}")
        there = load_checkpoint(path)

    kind = system_kind(recipe.system)
    sets = sets_of(recipe) if sets is None else sets
    train, test = [m for part, _ in sets for m in part], [m for _, part in sets for m in part]
    names = [motion.name for motion in train]
    settings = {name: v for name, v in recipe.to_dict().items() if name not in ("system", "hidden", "layers")}
    first: Checkpoint | None = None
    if there is None:
        representation, normalizer = make_representation(recipe.representation, train[0].skeleton, recipe.fps), None
        if recipe.start is not None:
            first = _start_of(recipe)
            representation, normalizer = first.representation, first.normalizer
        sway = _sway_of(train, recipe.fps) if kind.controlled else None
        told = provenance(
            recipe.data[0] if len(recipe.data) == 1 else list(recipe.data),
            names, command, test_clips=[motion.name for motion in test],
        )  # fmt: skip
    else:
        representation, normalizer, told, sway = there.representation, there.normalizer, there.provenance, there.sway
        settings = {name: there.training[name] for name in settings if name in there.training}  # as it has them
        check_same_clips(path, recipe, told, sets)

    shown = [part for part, _ in sets]
    if recipe.mirror:
        shown = [[*part, *(mirrored(motion) for motion in part)] for part in shown]
    shown = [_one_after_another(part, recipe) if recipe.join else part for part in shown]
    train = [motion for part in shown for motion in part]
    window = {
        "length": recipe.length, "batch": recipe.batch, "rates": recipe.rates, "rotate": recipe.rotate,
        "pad": recipe.pad,
        "seed": recipe.seed, "groups": [k for k, part in enumerate(shown) for _ in part],
    }  # fmt: skip
    if normalizer is None and there is None and _normalised(recipe):  # a run that is there keeps what it has
        # on drawn windows, so that the random turns are in the statistics
        drawn = WindowSampler(train, representation, **window)
        normalizer = Normalizer.fit(drawn.sample() for _ in range(max(1, 2000 // recipe.batch)))
    batches = WindowSampler(train, representation, normalizer=normalizer, **window)
    parts = {part: representation.slices[part].indices(representation.dim)[:2] for part in kind.parts}
    if kind.reads:
        parts["features"] = representation.config()
    system = make_system(
        recipe.system, representation.dim, seed=recipe.seed, **parts, **{**recipe.options, **recipe.sizes()}
    )
    if first is not None:
        _begin_with(system, first)
    trainer = Trainer(
        system, batches, TrainingConfig(**recipe._only(TrainingConfig)),
        path=path, device=device, save_seconds=save_seconds, settings=settings, provenance=told, sway=sway,
    )  # fmt: skip
    if there is not None and header["resumable"]:
        trainer.resume()
    elif there is not None:
        trainer.model.load_state_dict(there.model.state_dict())
        trainer.step, trainer.seconds = recipe.steps, float(there.training.get("seconds", 0.0))
    return trainer


def check_same_clips(
    path: str | os.PathLike,
    recipe: Recipe,
    told: Mapping[str, Any],
    sets: Sequence[tuple[list[Motion], list[Motion]]],
) -> None:
    """:class:`CheckpointError` if the run in ``path``, of the provenance ``told``, has other training clips than
    ``sets``: what is kept out of these it may have been trained on."""
    names, there = [motion.name for part, _ in sets for motion in part], told.get("clips")
    if names != there:
        raise CheckpointError(
            f"{path}: was started on {len(there or ())} clips of {' + '.join(recipe.data)}, "
            f"now there are other ones ({len(names)} to train on)"
        )


def _sway_of(clips: Sequence[Motion], fps: float) -> Sway | None:
    """How the people in the clips sway as they walk; None where nobody walks, or no feet are known to see it by."""
    from .control.signals import NoGait
    from .control.sway import fit_sway
    from .motion.skeletons import recognise

    if recognise(clips[0].skeleton) is None:
        return None
    try:
        return fit_sway(clips, fps)
    except NoGait:
        return None


def _normalised(recipe: Recipe) -> bool:
    """Whether a run of the recipe is trained on normalised features."""
    from .training.systems import system_kind

    kind = system_kind(recipe.system)
    as_it_is = (recipe.representation == "positions" and not kind.normalized) or kind.reads
    return recipe.normalize == "on" or (recipe.normalize == "auto" and not as_it_is)


def _start_of(recipe: Recipe) -> Checkpoint:
    """The checkpoint that a run begins with; its features must be those of the recipe."""
    from .training.checkpoints import load_checkpoint

    try:
        first = load_checkpoint(recipe.start)
    except CheckpointError as error:
        stage = recipe.options.get("stage")
        what = f"stage {stage!r}" if stage else f"system {recipe.system!r}"
        raise CheckpointError(f"{what} cannot start: {error}") from None
    features = first.representation
    for name, asked, there in (
        ("system", recipe.system, first.system),
        ("representation", recipe.representation, None if features is None else features.name),
        ("fps", recipe.fps, None if features is None else features.fps),
    ):
        if asked != there:
            raise CheckpointError(f"{recipe.start}: has {name} {there!r}, a run that starts from it asks for {asked!r}")
    asked, there = _normalised(recipe), first.normalizer is not None
    if asked != there:  # the same weights would read other numbers
        features = {True: "normalised features", False: "features as they are"}
        raise CheckpointError(
            f"{recipe.start}: was trained on {features[there]}, a run that starts from it asks for {features[asked]} "
            f"(normalize {recipe.normalize!r})"
        )
    return first


def _begin_with(system: System, first: Checkpoint) -> None:
    """Give a new system the weights of a checkpoint, and see whether they are ready for its first stage."""
    mine = dataclasses.asdict(system.model.config)
    for name, value in first.config.items():
        if mine[name] != value and name != "features":
            raise CheckpointError(
                f"{first.path}: has {name} {value!r}, a run that starts from it asks for {mine[name]!r}"
            )
    system.model.load_state_dict(first.model.state_dict())
    if system.stages and system.stages[0].check is not None:
        try:
            system.stages[0].check(system.model)
        except TutorialError as error:
            raise CheckpointError(f"{first.path}: {error}") from None


def _one_after_another(clips: Sequence[Motion], recipe: Recipe) -> list[Motion]:
    """The clips as one that goes on and on, twice through or more: ``JOINED_SECONDS`` of them at least, before
    :func:`~tutorial_lib.motion.join.playlist` cuts them where they are joined, so that it is shorter than that."""
    from .motion.join import playlist

    seconds = max(JOINED_SECONDS, 2 * sum(clip.duration for clip in clips))
    return [playlist(clips, seconds=seconds, blend=recipe.join, seed=recipe.seed)]


def _recipe_at(path: str | os.PathLike, header: Mapping[str, Any]) -> Recipe:
    try:
        return recipe_in(header)
    except CheckpointError as error:
        raise CheckpointError(f"{path}: {error}") from None
