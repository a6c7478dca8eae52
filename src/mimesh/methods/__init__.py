"""Ways to give an identity a driving mesh's pose or motion, all behind one protocol (see `base.py`)."""

from .base import Drive, Method
from .find import MODELS, find_method, find_model

__all__ = ["MODELS", "Drive", "Method", "find_method", "find_model"]
