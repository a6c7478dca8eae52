"""The networks that can be trained, by name."""

from __future__ import annotations

from ...core.errors import InputError
from .base import Task

NETWORKS = ("npt", "aniformer", "limp", "mime", "hands")


def find_task(network: str) -> type[Task]:
    """Give the task of a network by its name.

    Raises:
        InputError: no network of that name can be trained.
    """
    if network == "npt":
        from .npt import NPTTask

        return NPTTask
    if network == "aniformer":
        from .aniformer import AniFormerTask

        return AniFormerTask
    if network == "limp":
        from .limp import LIMPTask

        return LIMPTask
    if network == "mime":
        from .mime import MimeTask

        return MimeTask
    if network == "hands":
        from .hands import HandsTask

        return HandsTask
    raise InputError(f"{network}: expected a model that can be trained ({', '.join(NETWORKS)}), found another")
