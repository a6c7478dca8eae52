"""Write docs/RESULTS.md and the README's table from the reports in docs/results.

Two parts that are never mixed: what users get (all shipped methods), and the reproduction of the papers' tables.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

from ..core.errors import InputError
from ..methods.find import is_table_model
from .frozen_sets import frozen_sets, role
from .markdown import (
    calibration_table,
    cell,
    kind_table,
    makers_table,
    markdown_table,
    not_applicable,
    warnings_table,
)
from .metrics import VERSION
from .protocols import HUMAN_NPT
from .tables import TABLES, paper_table

FITS_SHIPPED_BODY = (
    *("our body model and its joint limits", "trained on our body, which it fits"),
    "trained on our quadruped, which it fits",
)
"""Values of `given` (`measure.extra_inputs`) of methods that fit the shipped body.

They have tables of their own, because the truth of most test sets is made with that body.
"""
Key = tuple[str, str]
"""Name of a protocol and kind of pair."""


class Set(NamedTuple):
    """A test set of the page."""

    title: str
    key: Key
    about: str = ""


class Section(NamedTuple):
    """A part of the page: test sets that answer one question."""

    title: str
    about: str
    sets: tuple[Set, ...]


CHARACTERS = Section(
    "Characters of other makers",
    """Rigged characters of three makers, in the packs that are held back for tests: large heads (KayKit), stylised
people (Quaternius, of whose other packs four people are development data), realistic people (Rocketbox). No
network was trained on these characters. `mime` was trained on others of Rocketbox and of two packs of Quaternius, on
none of KayKit. *Clips* are frames of the characters' own clips; Rocketbox has none, so its characters take frames
of the shipped captures. Within one skeleton the truth is the identity under the same bone rotations as the driving
character. Across skeletons there is no true mesh: limbs are compared by
their directions, wrists and ankles by their place in units of the limb, soles and penetration with those of the
driving character
([conventions](conventions.md)).""",
    (
        Set("Table 6, one skeleton", ("characters", "table6")),
        Set("joint limits, one skeleton", ("characters", "limits")),
        Set("frames of clips, one skeleton", ("characters", "clips")),
        Set("Table 6, two skeletons", ("characters", "across-table6")),
        Set("joint limits, two skeletons", ("characters", "across-limits")),
        Set("frames of clips, two skeletons", ("characters", "across-clips")),
        Set("four people of one maker, Table 6", ("cross-body", "table6")),
        Set("four people of one maker, joint limits", ("cross-body", "limits")),
        Set("four people of one maker, captured poses", ("cross-body", "clips")),
    ),
)
STRESS = Section(
    "Where methods break",
    "Acrobatics, the limits of the joints, crossed legs, missing limbs. The role of each set stands with it.",
    (
        Set("acrobatics (clips of DeepMimic)", ("clips-aniformer", "stress")),
        Set("joint limits", ("human-wide", "limits"), "Poses drawn uniformly within the limits of the joints."),
        Set("legs touch", ("contact", "legs")),
        Set("a limb is missing", ("noise", "cropped")),
        Set("holes", ("noise", "holes")),
        Set("seen from one side", ("noise", "half")),
    ),
)
SHIPPED_BODY = Section(
    "People of the shipped body",
    """New people; truth and training people are made with one body model. `mime` and `skeleton` fit that model, so they
have tables of their own.""",
    (
        Set(
            "Table 6, the papers' training poses",
            ("human-npt", "seen"),
            "The 16 x 400 poses that the rows of the papers' tables are trained on; the shipped weights, trained on "
            "random poses of these ranges, have not seen them.",
        ),
        Set("Table 6, new poses", ("human-npt", "unseen")),
        Set("captured poses", ("human-wide", "clips")),
        Set("clips: the 80 motions of AniFormer's tables", ("clips-aniformer", "seen")),
        Set("clips: held-out takes", ("clips-aniformer", "held-out")),
        Set("clips: new walks and splines", ("clips-aniformer", "procedural")),
        Set("driving mesh decimated", ("cross-topology", "decimated")),
        Set("driving mesh retriangulated", ("cross-topology", "retriangulated")),
        Set("driving mesh subdivided", ("cross-topology", "subdivided")),
        Set("driving points without faces", ("cross-topology", "points")),
        *(Set(f"noise of up to {p} % on the driving mesh", ("noise", f"noise-{p}")) for p in range(6)),
        *(
            Set(f"new garments on {who}", ("dressed", f"new-{kind}"), "No training wore these garments.")
            for kind, who in (("identity", "the identity"), ("driving", "the driving person"), ("both", "both"))
        ),
        *(
            Set(f"garments of the training on {who}", ("dressed", kind))
            for kind, who in (("identity", "the identity"), ("driving", "the driving person"), ("both", "both"))
        ),
        Set("hands touch", ("contact", "hands")),
        Set("arms touch", ("contact", "arms")),
    ),
)
FINGERS = Section(
    "Fingers",
    """People of the shipped body in poses of Table 6 with fingers in gestures, and realistic characters of the packs
that are held back for tests. Errors are measured in the frame of the palm, so that those of the arm do not count.
`mime-rigid-fingers` is `mime` with fingers that follow the hand; a method with a larger error than `identity`, the
identity not moved, is worse than no transfer.""",
    (
        Set("characters, the driving hands in gestures", ("fingers", "characters")),
        Set("people, the driving hands in gestures", ("fingers", "rest")),
        Set("people, both meshes' hands in gestures", ("fingers", "gesture")),
        Set("people, all fingers at rest", ("fingers", "still"), "Fingers must follow the hand."),
    ),
)
ANIMALS = Section(
    "Four-legged animals",
    """New animals of the shipped quadruped, in gaits, everyday poses and poses within the limits of its joints, and
rigged animals of one maker, whose rigs share the names of joints: there the truth is the identity under the bone
rotations of the driving animal. `identity` is the identity, not moved.""",
    (
        Set("gaits", ("quadruped", "gaits")),
        Set("everyday poses", ("quadruped", "usual")),
        Set("joint limits", ("quadruped", "limits")),
        Set("animals of one maker, frames of their clips", ("animals", "clips")),
    ),
)
SECTIONS = (CHARACTERS, STRESS, SHIPPED_BODY, FINGERS, ANIMALS)
README_METHODS = {
    "deformation-transfer-13": "deformation transfer, with a third mesh and 13 markers",
    "mime": "`mime`, our default, with the two meshes alone",
    "npt": "`npt`, NPT (CVPR 2020) in a narrow network, trained on other data than its paper's",
    "identity": "the identity, not moved",
}
"""Method -> its name in the README's table."""
README_MARKS = ("<!-- results:begin -->", "<!-- results:end -->")
HEAD = """# Results

Generated by `scripts/write_results.py` from the reports in [results/](results); not written by hand. The reports have
the figures of every single pair (`each`), with the pair's checksum.

**PMD** is Eq. 7 of both papers, x1e-4: the mean over vertices of the *squared* distance, with the truth in the unit
sphere about its bounding box. Results of the papers' networks are compared as the networks give them, in that frame;
all others are moved to the truth by the centres of the boxes, because their position is no part of the task. Lower is
better. It is squared: a tenth of the PMD is about a third of the distance, so read the **mm** beside it (mean distance
for a person 1.7 m tall, boxes centred). The mean is dominated by the worst pairs, the median shows the typical one.
*Public formula* is that of NPT's public evaluator, x1e-4: the mean square over the coordinates, in metres, each mesh
about the centre of its own box. AniFormer's evaluation is not published. Which of the two formulas the papers print is
not known. Behind ± is half of the 95 % interval of the mean over people (in clips over people and takes): pairs that
share one are not independent. *Better than* is the share of pairs with a lower PMD. Times were taken beside other work,
on one core: they are upper bounds; [models](models.md) has measured ones.

**Which data.** The pairs of every set are frozen by name and checksum. *Development* sets were looked at while methods
were made, and led to changes. *Test* sets did not lead to a change by themselves, but those of people of the shipped
body were measured after each of three trainings of `mime` ([log](LOG.md)); the pool of characters, the held-out takes
and the new garments were measured once, with weights that were made before these sets. Options were chosen on `val`.

**What is given.** Up and front are given to all methods. The column *given* says what else: the third mesh is the
driving person in the identity's pose, control points are marked by name, the true size is the truth's radius. The row
`copy` is the driving person's own vertices with the true correspondence, without damage and dressed as the identity
(noise stays): a method with a larger error is worse than no transfer; characters of different files have no such
correspondence. The row `identity` is the identity, not moved. The row `truth` shows what the figures can resolve.
"""
REPRODUCTION = """Counterparts of the papers' tables: another body, other data, less compute and another optimizer, so
an equal figure does not mean an equal network. *Narrow* and *equal time* have a quarter to a half of the width. *Mixed
people and limbs* were trained on more than the papers' data. As far as the published code tells, the paper's figures of
AniFormer are of meshes in one vertex order. [The two papers](papers.md) says what else differs. *Seen* are the
poses or motions of the training."""
MIRRORED = """The pairs of `human-npt` and their mirror images (`mimesh evaluate human-npt --mirror`), PMD x1e-4, mean.
A network that was trained on one side only is many times worse on the other."""
CONFIDENCE = """`mime` warns where it expects a large error. *Uncertainty* is the expected error over its threshold, or
what is missing of a limb or how far it is folded over theirs if that is larger; above 1 the user is warned. Bad results
should be warned of, good ones should not. Pairs without a true mesh are not counted, and the kinds of `noise` are the
same people and poses."""


def results_page(folder: Path) -> str:
    """Format all reports of a folder (JSON files) as one page.

    Raises:
        InputError: as `read_reports`.
    """
    reports = read_reports(folder)
    rows = rows_by_set(reports)
    parts = [HEAD]
    for section in SECTIONS:
        parts += [f"## {section.title}", section.about]
        parts += [part for test_set in section.sets for part in _set_tables(test_set, rows.get(test_set.key, []))]
        parts += _makers_tables(rows) if section is CHARACTERS else []
    parts += ["## The papers' tables", REPRODUCTION]
    parts += [part for name in TABLES for part in (f"### Table {name}", paper_table(name, *reports.values()))]
    if mirror := _mirror_table(rows):
        parts += ["### Mirror images", MIRRORED, mirror]
    parts += ["## Warnings", CONFIDENCE, *_confidence_tables(rows), "## Where the figures come from"]
    parts += [_origin(stem, report) for stem, report in reports.items()]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def read_reports(folder: Path) -> dict[str, dict[str, Any]]:
    """Read the reports of a folder by file name without suffix.

    Raises:
        InputError: a report of another version of the metrics, of another split than `test` or of other pairs than the
            frozen ones, or a method that two reports have on the same pairs.
    """
    reports = {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.json"))}
    found: dict[tuple[str, str, str], str] = {}
    for stem, report in reports.items():
        if (version := report.get("metrics", 1)) != VERSION:
            raise InputError(
                f"{stem}.json: expected figures of version {VERSION} of the metrics, found version {version}; "
                "measure it again"
            )
        if report["provenance"]["config"].get("split") != "test":
            raise InputError(f"{stem}.json: expected figures of the split test, found others; measure it again")
        for kind, facts in report.get("sets", {}).items():
            if facts["frozen"] not in ("same", "unknown"):
                raise InputError(
                    f"{stem}.json: expected all pairs of the frozen set {report['protocol']} {kind}, found others; "
                    "measure it again"
                )
        for row in report["results"]:
            key = (report["protocol"], row["split"], row["method"])
            if key in found:
                raise InputError(
                    f"{stem}.json: expected figures that no other report has, found {' '.join(key)} in "
                    f"{found[key]}.json too; remove one"
                )
            found[key] = stem
    return reports


def rows_by_set(reports: dict[str, dict[str, Any]]) -> dict[Key, list[dict[str, Any]]]:
    """Collect the rows of all reports by protocol and kind of pair."""
    rows: dict[Key, list[dict[str, Any]]] = {}
    for report in reports.values():
        for row in report["results"]:
            rows.setdefault((report["protocol"], row["split"]), []).append(row)
    return rows


def readme_table(folder: Path) -> str:
    """Format the README's table: the mean distance on characters of other makers, in frames of clips."""
    found = {row["method"]: row for row in rows_by_set(read_reports(folder)).get(("characters", "clips"), [])}
    lines = [
        [label, f"{cell(found[method], 'mm')} mm" if method in found else "not measured"]
        for method, label in README_METHODS.items()
    ]
    return markdown_table(["method", "people of other makers, in frames of motions"], lines)


def with_readme_table(text: str, table: str) -> str:
    """Return the text of the README with the table between its two marks replaced."""
    before, rest = text.split(README_MARKS[0])
    return f"{before}{README_MARKS[0]}\n\n{table}\n\n{README_MARKS[1]}{rest.split(README_MARKS[1])[1]}"


def _set_tables(test_set: Set, rows: list[dict[str, Any]]) -> list[str]:
    """Format the tables of a test set: methods without a body model, then those that fit the shipped body."""
    ours = [row for row in rows if not is_table_model(row["method"])]
    parts = [f"### {test_set.title}", _set_facts(test_set)]
    if not ours:
        return [*parts, "Not measured."]
    for title, fits in (("Without a body model:", False), ("With the shipped body's model:", True)):
        chosen = [row for row in ours if fits == (row["given"] in FITS_SHIPPED_BODY)]
        if chosen:
            parts += [title, kind_table(chosen, ours)]
    return [*parts, *not_applicable(ours)]


def _set_facts(test_set: Set) -> str:
    """Say what a set is: protocol and kind, role, distance to the training data, and what a reader must know."""
    protocol, kind = test_set.key
    text = f"`{protocol} {kind}`, {role(protocol, 'test', kind)} data. {test_set.about}"
    stored = frozen_sets().get((protocol, "test", kind))
    if stored is None:
        return text
    notes = [stored.note[:1].upper() + stored.note[1:]] if stored.note else []
    if stored.degrees_to_training is not None:
        least, median = stored.degrees_to_training
        notes += [f"The nearest training frame is {median:g} degrees away (mean over the joints) in the median, at "
                  f"least {least:g}"]  # fmt: skip
    return f"{text} {'. '.join(notes)}{'.' if notes else ''}"


def _mirror_table(rows: dict[Key, list[dict[str, Any]]]) -> str:
    """Format the errors on the pairs of `human-npt` beside those on their mirror images; empty if none was measured."""
    kinds = [f"{kind}{end}" for kind in HUMAN_NPT.kinds for end in ("", ", mirrored")]
    by_method = {kind: {row["method"]: row for row in rows.get((HUMAN_NPT.name, kind), [])} for kind in kinds}
    lines = [
        [f"`{method}`", *(cell(by_method[kind].get(method), "pmd_e4") for kind in kinds)]
        for method in by_method[kinds[1]]
    ]
    return markdown_table(["method", *kinds], lines) if lines else ""


def _makers_tables(rows: dict[Key, list[dict[str, Any]]]) -> list[str]:
    """Format the errors on the pool of characters by maker, of the methods that need no more than the two meshes."""
    parts = ["### By maker", "Median / mean of the pairs (their number), by the identity's maker and pack."]
    for method in ("mime", "mime-network", "npt", "identity"):
        chosen = [row for key, found in rows.items() if key[0] == "characters" for row in found]
        chosen = [row for row in chosen if row["method"] == method and row["pairs"]]
        if chosen:
            parts += [f"`{method}`:", makers_table(chosen)]
    return parts if len(parts) > 2 else []


def _confidence_tables(rows: dict[Key, list[dict[str, Any]]]) -> list[str]:
    """Format what the warnings of `mime` are worth on each test set, and calibration curves.

    Sets of different roles are never pooled.
    """
    sets, by_role = {}, {"test": [], "other": []}
    for section in SECTIONS:
        for test_set in section.sets:
            found = [row for row in rows.get(test_set.key, []) if row["method"] == "mime"]
            sets[f"{section.title}: {test_set.title}"] = found
            by_role["test" if role(test_set.key[0], "test", test_set.key[1]) == "test" else "other"] += found
    pooled = {"all test sets": by_role["test"], "all development and stress sets": by_role["other"]}
    curves = [part for name, found in pooled.items() for part in (f"{name.capitalize()}:", calibration_table(found))]
    return [warnings_table(sets | pooled), *curves]


def _origin(stem: str, report: dict[str, Any]) -> str:
    """Say where a report was measured, and what it lacks."""
    provenance = report["provenance"]
    text = f"* `{stem}.json`: commit {provenance['commit']}, {provenance['machine']}, {provenance['date'][:10]}."
    if "sets" not in report:
        text += " Measured before reports had the figures of single pairs."
    return f"{text} The working tree had uncommitted changes." if provenance["commit"].endswith("-dirty") else text
