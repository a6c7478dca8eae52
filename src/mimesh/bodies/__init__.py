"""Rigged bodies: the shipped human, random people and poses, garments, characters, and fitting to points."""

from .body_model import RiggedBody, load_body
from .characters import CHARACTERS, character

__all__ = ["CHARACTERS", "RiggedBody", "character", "load_body"]
