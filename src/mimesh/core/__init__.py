"""Data types and arithmetic that every other package uses; it imports none of them."""
