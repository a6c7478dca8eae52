"""Rigged bodies and how to sample them: people for training, protocols and the demo."""

from .cast import CAST, character
from .rigged import RiggedBody, load_body, save_body

__all__ = ["CAST", "RiggedBody", "character", "load_body", "save_body"]
