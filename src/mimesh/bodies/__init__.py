"""Rigged bodies and how to sample them: people for training, protocols and the demo."""

from .body_model import RiggedBody, load_body, save_body
from .characters import CHARACTERS, character

__all__ = ["CHARACTERS", "RiggedBody", "character", "load_body", "save_body"]
