"""Files that several tests of protocols read."""

import pytest
from held_out_files import write_takes


@pytest.fixture(scope="session")
def motions(tmp_path_factory):
    """A folder with generated motions in the place of all files of others."""
    return write_takes(tmp_path_factory.mktemp("motions"))
