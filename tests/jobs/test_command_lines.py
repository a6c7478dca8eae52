"""Options of a batch's jobs, as the commands parse them."""

from __future__ import annotations

from mimesh.core.budgets import limits_are_lifted
from mimesh.core.output_size import LARGEST_OUTPUT, check_output_size
from mimesh.jobs.command_lines import parsed
from mimesh.jobs.table import BatchJob


def test_what_options_set_ends_with_the_parsing():
    def job(**options: str) -> BatchJob:
        return BatchJob("row 1", "transfer", "hero.obj", "pose.obj", "out.obj", tuple(options.items()))

    assert parsed(job(**{"no-limits": "yes"}))["no_limits"]
    assert not limits_are_lifted()
    assert parsed(job())["large"] is False
    check_output_size(2 * int(LARGEST_OUTPUT), "out.obj", "write less of it")  # outputs of Python have no limit
