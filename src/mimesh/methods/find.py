"""Names of all models, and `find_model`, which opens one by name."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import InputError, did_you_mean, option
from ..core.mesh import Clip, Mesh
from ..core.options import ModelOptions, check_value, needs_joints, values_of
from .base import Drive, Method

if TYPE_CHECKING:
    from ..mime.model import Mime

# Names that `find_model` takes, besides those of WITHOUT_NETWORK and paths of .onnx files.
SHIPPED_NETWORKS = ("mime", "npt", "npt-maxpool", "aniformer")
NETWORK_OF_BODY = {"human": "mime", "quadruped": "mime-quadruped"}
"""Shipped body -> the network that finds its joints. `mime` opens the others itself; their names are for measuring."""
INDEX_PAIRED = {"npt": "npt-ordered-mixed", "aniformer": "aniformer-ordered-mixed"}
"""Shipped network that pairs vertices at random -> the shipped one that pairs them by index."""
WITHOUT_NETWORK = ("copy", "deformation-transfer")
"""Methods that have no weights."""
TRAINED_WITH_TABLE = {
    "npt-1": ("mime-table",),
    "npt-2": ("npt-equal", "npt-no-edge", "npt-no-spadain", "npt-concat1"),
    "npt-7": ("npt-maxpool-equal",),
    "aniformer-1": (
        *("aniformer-ordered-equal", "aniformer-ordered-motion", "aniformer-ordered-appearance"),
        *("aniformer-ordered-plain", "aniformer-ordered-vanilla", "aniformer-ordered-attention-vertices"),
        "aniformer-ordered-vertices",
    ),
    "aniformer-2": ("npt-ordered-equal", "npt-maxpool-ordered-equal"),
    "aniformer-1-random": (
        *("aniformer-equal", "aniformer-motion", "aniformer-appearance", "aniformer-plain", "aniformer-regression"),
    ),
    "aniformer-2-random": ("npt-frames", "npt-maxpool-frames"),
}
"""Table of a paper -> networks that `mimesh table NAME --train` makes; other tables have rows of some of them, too."""
TRAINED_ON_GPU = ("npt-full", "npt-full-mixed", "npt-ordered", "aniformer-ordered")
"""Networks of the tables that scripts/train_on_gpu.py makes, beside INDEX_PAIRED."""
TABLE_MODELS = (*(name for names in TRAINED_WITH_TABLE.values() for name in names), *TRAINED_ON_GPU)
"""Networks of the papers' tables, for comparison only: in a checkout's folder `ablations`, not installed, or in another
folder (`runs/tables/npt-equal`), where `mimesh table --train` put them."""
ABLATIONS, TRAINED = Path("ablations"), Path("runs", "tables", "seed0")
"""Folders of these networks where none is named: that of a checkout, and the one that `mimesh table --train` fills."""
WITHOUT_FIT = {"mime-network": "mime", "mime-table-network": "mime-table"}
"""Name -> network that is used without the body fit, to measure what the fit contributes."""
WITHOUT_FINGERS = {"mime-rigid-fingers": "mime"}
"""Name -> network whose results have fingers that follow the hand, to measure what moving them contributes."""
REDUCED_MODELS = WITHOUT_FIT | WITHOUT_FINGERS
"""All networks that are used without a part."""
MODELS = (*WITHOUT_NETWORK, *SHIPPED_NETWORKS)
"""Names of the methods that every installation has."""


@dataclass(frozen=True)
class CopyMethod:
    """The method `copy`: vertex i of the result is vertex i of the driving."""

    rough: ClassVar[bool] = False
    name: str = "copy"

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """Check that the vertex counts agree, which is all that can be checked, and return the driving frames.

        Raises:
            InputError: the vertex counts differ.
        """
        count = len(driving.mesh.vertices)
        if len(identity.vertices) != count:
            raise InputError(
                f"{driving.mesh.name}: expected {len(identity.vertices)} vertices as in {identity.name} for model "
                f"copy, found {count}; choose another model"
            )
        return _copy


def _copy(frames: Iterable[Float[np.ndarray, "V 3"]]) -> Iterator[Float[np.ndarray, "V 3"]]:
    yield from frames


def weights_path(model: str) -> Path:
    """Return the path of a network's weights, from one of the names above or from a path."""
    if is_table_model(model):
        path = Path(model)
        file = f"{REDUCED_MODELS.get(path.name, path.name)}.onnx"
        if model != path.name:
            return path.parent / file
        return TRAINED / file if (TRAINED / file).is_file() and not (ABLATIONS / file).is_file() else ABLATIONS / file
    model = REDUCED_MODELS.get(model, model)
    if model in (*SHIPPED_NETWORKS, *INDEX_PAIRED.values(), *NETWORK_OF_BODY.values()):
        return Path(str(resources.files("mimesh.methods") / "zoo" / f"{model}.onnx"))
    return Path(model)


def ordered_weights(model: str) -> Path | None:
    """Return the path of the weights of one of INDEX_PAIRED that pair vertices by index; None for other networks."""
    return weights_path(INDEX_PAIRED[model]) if model in INDEX_PAIRED else None


def is_table_model(model: str) -> bool:
    """Tell whether a name is one of a network of the tables, with or without a folder.

    Those of INDEX_PAIRED are rows, too, but without a folder they are the shipped ones.
    """
    name = Path(model).name
    return REDUCED_MODELS.get(name, name) in TABLE_MODELS or (name != model and name in INDEX_PAIRED.values())


def missing_weights(*models: str) -> list[str]:
    """List those of some models that are networks of the tables, or pair by index, and have no weights here."""
    named = [model for model in models if is_table_model(model) or model in INDEX_PAIRED.values()]
    return [model for model in named if not weights_path(model).is_file()]


def how_to_make(models: Iterable[str], table: str = "") -> str:
    """Name the commands that make networks of the tables, each with the networks that it is for.

    Args:
        table: table that these are rows of; the one that each network is listed under, where none is given.
    """
    made: dict[str, list[str]] = {}
    for model in models:
        path = Path(model)
        name = REDUCED_MODELS.get(path.name, path.name)
        command = "python scripts/train_on_gpu.py OUT (one GPU)"
        for key, names in TRAINED_WITH_TABLE.items():
            command = f"mimesh table {table or key} --train" if name in names else command
        made.setdefault(command, []).append(path.name)
    return "; ".join(f"{', '.join(names)} by {command}" for command, names in made.items())


def check_weights(*models: str) -> None:
    """Check that networks of the tables have their weights; other names and paths pass.

    Raises:
        InputError: some have not; all of them are named, with the commands that make them.
    """
    if missing := missing_weights(*models):
        folders = ", ".join(dict.fromkeys(str(weights_path(model).parent) for model in missing))
        raise InputError(
            f"{', '.join(missing)}: expected weights in {folders}, found no files; call this in the root of a "
            f"checkout, which has some of them, give others with {option('model', ...)}, or make "
            f"{how_to_make(missing)}, and give the path of the .onnx file that is written"
        )


def moves_joints(model: str) -> bool:
    """Whether a model moves joints, not vertices: it takes the rigs of the files, and files of joints are written."""
    if model in (*NETWORK_OF_BODY.values(), *WITHOUT_NETWORK):
        return model in NETWORK_OF_BODY.values()
    from ..mime.model import Mime

    return isinstance(find_model(model), Mime)


def find_method(model: str, **options: Any) -> Method:
    """Return the method of a name or of an `.onnx` file that moves vertices; `options` are those of `find_model`.

    Raises:
        InputError: as `find_model`, or the model moves joints.
    """
    found = find_model(model, **options)
    if not isinstance(found, Method):
        raise InputError(
            f"{option('model')}: expected a model that moves vertices, found {model}, which moves joints; try npt"
        )
    return found


def find_mime(model: str, seed: int = 0) -> Mime:
    """Return the model of a name or a file, which must find joints.

    Raises:
        InputError: it does not, or there is no such model.
    """
    from ..mime.model import Mime

    found = find_model(model, seed=seed)
    if not isinstance(found, Mime):
        raise needs_joints("model", model)
    return found


def _with_other_bodies(mime: Mime, seed: int) -> Mime:
    others = {body: partial(_kept_mime, model, seed) for body, model in NETWORK_OF_BODY.items() if body != mime.body}
    return dataclasses.replace(mime, other_bodies=others)


@lru_cache(maxsize=4)
def _kept_mime(model: str, seed: int) -> Mime:
    """Return the shipped network of a body; the choice of a body asks for it again."""
    return find_mime(model, seed)


def find_model(
    model: str,
    *,
    ensemble: int = 1,
    seed: int = 0,
    pairing: str = "auto",
    reference: Mesh | None = None,
    markers: Int[np.ndarray, "M 2"] | None = None,
) -> Mime | Method:
    """Return the model of a name (MODELS, TABLE_MODELS, REDUCED_MODELS) or of an `.onnx` file of `mimesh export`.

    Args:
        model: the name or the path.
        ensemble: average over this many random pairings of driving and identity vertices (index-paired networks only).
        seed: seed of those pairings, and of sampled points.
        pairing: "random" or "order": how the network must pair vertices, where INDEX_PAIRED have weights for both;
            "auto": as it does, at random where there are both.
        reference: the driving subject in the identity's pose, normalised like the driving mesh, whose vertices and
            faces it shares (deformation transfer only).
        markers: identity and driving vertex of points that correspond (deformation transfer only).

    Raises:
        InputError: no such model, its file is missing or was not written by `mimesh export`, or an option cannot be
            used with it.
    """
    from ..mime.model import Mime
    from .onnx_models import load_network

    if ensemble < 1:
        raise InputError(f"{option('ensemble')}: expected 1 or more pairings, found {ensemble}; give a positive number")
    check_value("pairing", pairing, values_of(ModelOptions, "pairing"))
    if pairing == "order" and model in WITHOUT_NETWORK:
        raise _other_pairing(pairing, model)
    if model == "copy":
        return CopyMethod()
    if model == "deformation-transfer":
        from .deformation_transfer import DeformationTransfer

        return DeformationTransfer(reference, markers)
    check_weights(model)
    path = weights_path(model)
    if pairing == "order" and (ordered := ordered_weights(model)) is not None:
        path = ordered
        if not path.is_file():
            raise InputError(
                f"{option('pairing', pairing)}: expected weights in {path}, found no file; make some with mimesh "
                f"train {model} "
                f"--set data.pairing=order and mimesh export, and choose that file, or leave {option('pairing')} out"
            )
    if path.suffix == ".onnx":
        known = Path(model).name
        name = known if known in REDUCED_MODELS else path.stem
        network = load_network(
            path,
            name=name,
            ensemble=ensemble,
            seed=seed,
            fits=known not in WITHOUT_FIT,
            fingers=known not in (*REDUCED_MODELS, *TABLE_MODELS),
        )
        if pairing not in ("auto", getattr(network, "pairing", "random")):
            raise _other_pairing(pairing, model)
        return _with_other_bodies(network, seed) if model == "mime" and isinstance(network, Mime) else network
    raise InputError(
        f"{option('model')}: expected one of {', '.join(MODELS)} or the path of an .onnx file, found {model!r}"
        + did_you_mean(model, (*MODELS, *NETWORK_OF_BODY.values()))
    )


def _other_pairing(pairing: str, model: str) -> InputError:
    return InputError(
        f"{option('pairing', pairing)}: expected a network of npt or aniformer that was trained with "
        f"data.pairing={pairing}, found {model}; leave {option('pairing')} out"
    )
