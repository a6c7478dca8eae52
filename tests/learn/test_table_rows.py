"""Training the networks of a table: all rows and seeds, resumed where it was stopped, measured in their place."""

import json

import pytest
from typer.testing import CliRunner

from mimesh.__main__ import app
from mimesh.__main__ import run as main_run
from mimesh.core.errors import InputError
from mimesh.evaluate import tables
from mimesh.evaluate.tables import TABLES, Row, Table, over_seeds
from mimesh.learn import checkpoint, table_rows
from mimesh.learn.loop import TrainingRun
from mimesh.learn.table_rows import ROWS, TrainedRow, row_config, rows_of, train_row, train_table
from mimesh.methods.find import TRAINED_WITH_TABLE, how_to_make, is_table_model, weights_path

TINY = ("model.encoder=[8,16,16]", "model.decoder=[16,8,8]", "data.vertices=32", "batch=2", "validation_pairs=1")


@pytest.fixture
def small_table(monkeypatch, tmp_path):
    """A table of three networks that train in a second, one of them far too long for a table, and `copy`."""
    rows = (
        Row("NPT", "npt-equal", 1.1, 9.3),
        Row("no edge", "npt-no-edge"),
        Row("long", "npt-full"),
        Row("copy", "copy"),
    )
    monkeypatch.setitem(tables.TABLES, "npt-2", Table("small", "human-npt", rows))
    recipes = {"npt-equal": TrainedRow("npt", TINY), "npt-no-edge": TrainedRow("npt", (*TINY, "edge=off"))}
    recipes["npt-full"] = TrainedRow("npt", (*TINY, "pairs=4", "minutes=0"), equal_time=False, long=True)
    monkeypatch.setattr(table_rows, "ROWS", recipes)
    monkeypatch.chdir(tmp_path)


def run(*words):
    return CliRunner().invoke(app, ["table", "npt-2", "--pairs", "1", "--minutes", "0.001", *words])


@pytest.mark.slow
@pytest.mark.usefixtures("small_table", "tiny_exports")
def test_a_table_is_trained_with_seeds_and_measured(tmp_path):
    done = run("--train", "--seeds", "2", "--without", "npt-no-edge", "--without", "npt-full", "-o", "table.json")
    assert done.exit_code == 0, done.output
    report = json.loads((tmp_path / "table.json").read_text())
    methods = {row["method"] for row in report["results"]}
    assert methods == {"runs/tables/seed0/npt-equal", "runs/tables/seed1/npt-equal", "copy"}
    seeds = [checkpoint.load(tmp_path / f"runs/tables/seed{seed}/npt-equal/last.safetensors") for seed in (0, 1)]
    assert [state.config.seed for state in seeds] == [0, 1]
    errors = [row["pmd_e4"] for row in report["results"] if row["split"] == "seen" and "npt-equal" in row["method"]]
    assert errors[0] != errors[1]
    (line,) = [line for line in done.output.splitlines() if line.startswith("| NPT |")]
    mean, deviation = sum(errors) / 2, abs(errors[0] - errors[1]) / 2**0.5
    half = f"{deviation:.2g}" if deviation < 99.5 else f"{deviation:.0f}"
    assert f"| {mean:.3g} ± {half} |" in line or f"| {mean:.0f} ± {half} |" in line
    assert "mean over 2 seeds" in done.output
    # What is finished is kept, and what was killed before it wrote its card is exported again.
    network = tmp_path / "runs/tables/seed0/npt-equal.onnx"
    written, card = network.stat().st_mtime_ns, network.with_suffix(".json")
    train_row("npt-equal", 0, 0.001, network.parent)
    assert network.stat().st_mtime_ns == written
    card.unlink()
    train_row("npt-equal", 0, 0.001, network.parent)
    assert card.exists()


@pytest.mark.usefixtures("small_table")
def test_a_folder_with_a_training_of_another_recipe_is_refused(tmp_path, capsys, monkeypatch):
    started = TrainingRun.start(row_config("npt-equal", 0, 0.001), tmp_path)
    folder = tmp_path / "runs/tables/seed0/npt-equal"
    folder.mkdir(parents=True)
    started.save(folder / "last.safetensors")
    found = r"found another \(minutes 0\.002 here, 0\.001 there\); choose"
    with pytest.raises(InputError, match=f"expected no training, or one with this configuration, {found}"):
        train_row("npt-equal", 0, 0.002, folder.parent)
    recipe = TrainedRow("npt", (*TINY, "data.vertices=64", "model.encoder=[8,16,32]", "edge=off"))
    monkeypatch.setitem(table_rows.ROWS, "npt-equal", recipe)
    words = ["--minutes", "0.001", "--without", "npt-full", "--without", "npt-no-edge"]
    assert main_run(["table", "npt-2", "--train", *words]) == 2
    message = capsys.readouterr().err
    assert "data.vertices 64 here, 32 there" in message
    assert "model.encoder [8, 16, 32] here, [8, 16, 16] there" in message
    assert "edge off here, " in message
    assert message.count(" here, ") == 3


@pytest.mark.usefixtures("small_table")
def test_what_is_trained_is_told_and_rows_without_weights_are_left_out_with_a_note(tmp_path, capsys, monkeypatch):
    """`npt-full` is not trained without --long. The trainings themselves are left out."""
    trained = []
    monkeypatch.setattr(table_rows, "train_row", lambda row, seed, minutes, folder: trained.append((row, seed)))
    said = []
    train_table("npt-2", tmp_path, 0.001, seeds=2, long=True, say=said.append, without=["npt-no-edge"])
    assert trained == [(row, seed) for seed in (0, 1) for row in ("npt-equal", "npt-full")]
    assert said[0] == "4 trainings: 0 CPU minutes, and those that end after a number of pairs"
    words = ["--without", "npt-no-edge", "--without", "npt-equal", "--pairs", "1"]
    assert main_run(["table", "npt-2", "--train", "--minutes", "0.001", *words]) == 0
    note = "or make npt-full by python scripts/train_on_gpu.py"
    assert note in "".join(capsys.readouterr())
    assert len(trained) == 4


@pytest.mark.usefixtures("small_table")
def test_a_table_is_measured_without_the_rows_that_have_no_weights():
    words = [word for row in ("npt-equal", "npt-no-edge", "npt-full") for word in ("--without", row)]
    done = CliRunner().invoke(app, ["table", "npt-2", "--pairs", "1", *words])
    assert done.exit_code == 0, done.output
    assert "| - | `copy` |" in done.output
    assert "npt-equal" not in done.output


@pytest.mark.usefixtures("small_table")
def test_rows_to_leave_out_must_be_rows_of_the_table(capsys, tmp_path):
    assert main_run(["table", "npt-2", "--train", "--without", "limp"]) == 2
    message = capsys.readouterr().err
    assert "--without limp: expected a row of npt-2 (npt-equal, npt-no-edge, npt-full, copy)" in message
    words = [word for row in ("npt-equal", "npt-no-edge", "npt-full", "copy") for word in ("--without", row)]
    assert main_run(["table", "npt-2", *words]) == 2
    assert "leave fewer out" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


@pytest.mark.usefixtures("small_table")
def test_options_of_a_training_need_the_training(tmp_path):
    done = run("--seeds", "3")
    assert isinstance(done.exception, InputError)
    assert "add --train" in str(done.exception)
    done = CliRunner().invoke(app, ["table", "npt-2", "--train", "--minutes", "0"])
    assert "--minutes: expected a positive number" in str(done.exception)


def test_rows_that_take_hours_are_trained_only_where_asked():
    assert "npt-full" not in rows_of("npt-1", long=False)
    assert "npt-full" in rows_of("npt-1", long=True)
    assert rows_of("npt-1", long=False) == ["mime-table"]  # its network without the fit is the same network
    with pytest.raises(InputError, match="expected a table"):
        rows_of("npt-3", long=False)


def test_every_recipe_is_a_configuration():
    methods = {entry.method for table in TABLES.values() for entry in table.rows}
    for row, recipe in ROWS.items():
        config = row_config(row, 3, 21.0)
        assert config.seed == 3
        assert (config.minutes == 21) == recipe.equal_time
        assert row in methods


def test_networks_of_tables_may_lie_in_another_folder():
    assert weights_path("npt-equal").as_posix() == "ablations/npt-equal.onnx"
    assert weights_path("runs/tables/seed1/mime-table-network").as_posix() == "runs/tables/seed1/mime-table.onnx"
    assert not is_table_model("runs/npt-other")
    # A row that is shipped, too: by its name the shipped one, in a folder the one that was trained there.
    assert not is_table_model("aniformer-ordered-mixed")
    assert weights_path("runs/tables/seed0/aniformer-ordered-mixed").parent.name == "seed0"


def test_every_network_of_a_table_has_a_command_that_makes_it():
    for row, recipe in ROWS.items():
        made = how_to_make([row])
        assert ("train_on_gpu.py" in made) == (recipe.config == "gpu")
        assert ("--long" in made) == (recipe.long and recipe.config != "gpu")
    for table, names in TRAINED_WITH_TABLE.items():
        assert set(names) <= set(rows_of(table, long=False))


def test_figures_over_seeds_are_means_with_their_deviation():
    rows = [
        {"pairs": 2, "pmd_e4": value, "pmd_e4_ci95": 9.0, "pmd_e4_median": 4.0, "mm": value / 2}
        for value in (1.0, 2.0, 3.0)
    ]
    assert over_seeds(rows) == {"pairs": 2, "pmd_e4": 2.0, "pmd_e4_ci95": 1.0, "pmd_e4_median": 4.0, "mm": 1.0}
    assert over_seeds(rows[:1]) == rows[0]
    assert over_seeds([]) is None
