"""Networks: one model in one file."""
