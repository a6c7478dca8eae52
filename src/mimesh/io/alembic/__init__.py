"""Alembic archives (.abc) in and out."""
