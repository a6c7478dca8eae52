"""Fills marks in the pages with tables and measured figures, while the site is built.

`<!-- insert: WHAT [NAME] -->` may be followed by text up to `<!-- end of insert -->`: what those read who have the page
and no site. The site has the table in its place.
"""

from __future__ import annotations

import json
import math
import re
from functools import cache
from pathlib import Path

import typer
from write_results import read_reports, rows_by_set

from mimesh.__main__ import command_line
from mimesh.commands.about import DESCRIPTIONS
from mimesh.core import budgets
from mimesh.evaluate.markdown import cell, markdown_table
from mimesh.evaluate.tables import find_table, paper_table
from mimesh.methods.find import MODELS, SHIPPED_NETWORKS
from mimesh.methods.zoo import cards

DOCS = Path(__file__).parents[1]
SEEDS = DOCS / "results" / "seeds"
"""Reports of networks that were trained several times: runs/tables/seed0/NAME, runs/tables/seed1/NAME ..."""
MARK = re.compile(r"(<!-- insert: ([a-z]+)(?: ([\w-]+))? -->)(?:\n.*?\n<!-- end of insert -->)?", re.DOTALL)
DRAWING = re.compile(r"!\[([^\]]*)\]\(images/([\w-]+)\.svg\)")
OUTSIDE_LINK = re.compile(r"\[([^\]]+)\]\((?:\.\./[^)]*|results/?)\)")
"""Links that work in the repository but lead out of the site."""


def setup(app):
    """Register the replacement of marks with Sphinx."""
    app.connect("source-read", lambda app, page, source: source.__setitem__(0, filled(source[0])))
    return {"parallel_read_safe": True}


def filled(text: str) -> str:
    """Return a page with its marks replaced, links out of the site removed, and SVG drawings embedded.

    Embedded drawings have the colours of the site's theme.

    Raises:
        KeyError: a mark has an unknown name.
    """
    text = OUTSIDE_LINK.sub(r"\1", text)
    text = DRAWING.sub(lambda mark: _drawing(mark[2]), text)
    return MARK.sub(_content, text)


def _content(mark: re.Match[str]) -> str:
    return INSERTS[mark[2]](*filter(None, [mark[3]]))


def _drawing(name: str) -> str:
    return f'<div class="drawn">\n{(DOCS / "images" / f"{name}.svg").read_text()}</div>\n'


@cache
def figures_of(name: str) -> dict:
    """Read a file of measured figures once, by its path in the repository without suffix."""
    return json.loads((DOCS.parent / f"{name}.json").read_text(encoding="utf-8"))


def measured(report: dict) -> str:
    """Say where figures are from."""
    return f"Measured at commit {report['commit']}, {report['machine']}."


def models() -> str:
    """Return the table of the models that -m takes."""
    rows = []
    for name in MODELS:
        row = _report_row(name, "unseen")
        errors = ["", ""]
        if "mm" in row:
            pmd = f"{_figure(row['pmd_e4'])}\N{NO-BREAK SPACE}({_figure(row['pmd_e4_median'])})"
            errors = [pmd, f"{_figure(row['mm'])} mm"]
        rows.append([f"[`{name}`](#{name})", " ".join(DESCRIPTIONS[name].split()), *errors])
    return markdown_table(["`-m`", "what it is", "PMD ×1e-4: mean (median)", "distance"], rows)


RIG_FIGURES = ("joints_pct", "j2j", "j2b", "b2b", "iou", "weights_l1", "deform_mm")
"""Columns of the table of rigs in docs/comparison.md, in its order."""


def found_rigs() -> str:
    """Return the row of the table of rigs in docs/comparison.md, whose head is there, from benchmarks/rigs.json."""
    report = figures_of("benchmarks/rigs")
    [row] = [row for row in report["results"] if row["method"] == "mime"]
    origin = report["provenance"]
    split = origin["config"]["split"]
    makers = len({label.partition(": ")[0] for label in row["each"]["identity"]})
    figures = [cell(row, name) for name in RIG_FIGURES]
    figures[0] += " %"
    cells = [
        "`mimesh rig`",
        f"our split `{split}`: {row['pairs']} people of {makers} makers, {row.get('failures', 0)} refused",
        *figures,
        f"{cell(row, 'seconds_per_frame')} s, CPU",
        "22 joints, without fingers; trained on other people of two of the makers",
        "[definitions](conventions.md#rigs)",
    ]
    return f"| {' | '.join(cells)} |\n\n{measured(origin)}"


def _report_row(name: str, kind: str, method: str = "") -> dict:
    """Return the report row of a model, or of `method`, on the model's set: of poses, or of clips for aniformer.

    Empty where it has not been measured.
    """
    protocol = "clips-aniformer" if name == "aniformer" else "human-npt"
    method = method or {"deformation-transfer": "deformation-transfer-13"}.get(name, name)
    rows = rows_by_set(_reports()).get((protocol, kind), [])
    return next((row for row in rows if row["method"] == method), {})


@cache
def _reports() -> dict[str, dict]:
    """Read the reports of docs/results once."""
    return read_reports(DOCS / "results")


def card(name: str) -> str:
    """Return the card of shipped weights as a table."""
    assert name in SHIPPED_NETWORKS
    facts = next(card for card in cards() if card["name"] == name)
    earlier = facts.get("before", [])  # cards of the earlier stages of a training in several stages
    minutes = sum(stage["seconds_trained"] for stage in (*earlier, facts)) / 60
    pairs = sum(stage["pairs"] for stage in (*earlier, facts))
    seen, unseen = (_report_row(name, kind) for kind in ("seen", "unseen"))
    copies = (_report_row(name, kind, "copy") for kind in ("seen", "unseen"))
    stages = f" in {len(earlier) + 1} stages; the card has the configuration of the last one only" if earlier else ""
    dirty = " (a working tree with uncommitted changes)" if facts["commit"].endswith("-dirty") else ""
    # Shipped weights are not trained on the poses that the papers' rows have seen.
    what = "motions" if name == "aniformer" else "poses"
    sets = f"the tables' training {what} / new {what}"
    rows = [
        ["licence", facts["license"]],
        ["trained on", facts["data"]],
        ["training", f"{minutes:.0f} minutes, {facts['hardware']}; {pairs:,} pairs{stages}"],
        ["commit", f"`{facts['commit']}`{dirty}, seed {facts['seed']}"],
    ]
    if seen or unseen:
        rows += [
            [f"PMD ×1e-4 on new people, {sets}", _both(seen.get("pmd_e4"), unseen.get("pmd_e4"))],
            ["its median", _both(seen.get("pmd_e4_median"), unseen.get("pmd_e4_median"))],
            ["distance, for a person of 1.7 m", f"{_both(seen.get('mm'), unseen.get('mm'))} mm"],
            ["PMD of `copy` on the same", _both(*(row.get("pmd_e4") for row in copies))],
        ]
    rows.append(["file", f"`{facts['file']}`, {facts['bytes'] / 2**20:.1f} MiB"])
    return markdown_table(["card", ""], rows)


def table(name: str) -> str:
    """Return a table of a paper with its values next to ours, from the reports in docs/results.

    Narrow rows have several seeds there, in reports of their own with fewer pairs.
    """
    several = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(SEEDS.glob("*.json"))]
    trained: dict[str, list[str]] = {}
    for method in dict.fromkeys(row["method"] for report in several for row in report["results"]):
        trained.setdefault(Path(method).name, []).append(method)
    rows = {row.method for row in find_table(name).rows}
    return paper_table(
        name, *_reports().values(), *several, trained={row: trained[row] for row in trained if row in rows}
    )


def speed() -> str:
    """Return the table of times per frame, from benchmarks/mime.json."""
    report = figures_of("benchmarks/mime")
    counts = [key for key in report if key.isdigit()]
    lines = {
        "prepare, for a pose": "prepare_pose_ms",
        "prepare, for a clip": "prepare_clip_ms",
        "a frame of `mime`": "frame_ms",
        "plain skinning, for comparison": "plain_skinning_ms",
        "a frame of `npt`": "npt_ms_a_frame",
        "a frame of `npt-maxpool`": "npt-maxpool_ms_a_frame",
        "a frame of `aniformer`": "aniformer_ms_a_frame",
    }
    rows = [[label, *(_ms(report[count].get(key)) for count in counts)] for label, key in lines.items()]
    head = ["", *(f"{int(count):,} vertices" for count in counts)]
    return f"{markdown_table(head, rows)}\n\n{measured(report)}"


LARGE_CASES = {
    "mime": "`transfer`, driving of 6,890 vertices",
    "dense": "`transfer`, driving of as many vertices",
    "copy": "`transfer -m copy`",
    "animate": "`animate`",
    "large-clip": "`animate`, large identity",
    "parts": "`transfer`, identity of 500 objects",
    "morphs": "`transfer`, identity with 200 morph targets",
}
"""Cases of scripts/measure_large.py, as the table names them."""


def large() -> str:
    """Return the table of large inputs and the fitted exponents, from benchmarks/large.json."""
    report = figures_of("benchmarks/large")
    rows, commits = [], {}
    for case, label in LARGE_CASES.items():
        for figures in report["cases"].get(case, {}).values():
            commits[f"{figures['commit']}, {figures['machine']}"] = None
            seconds = (f"{figures['seconds'][step]:.2f}" for step in ("read", "moved", "write", "preview"))
            sizes = [f"{figures['vertices']:,}", f"{figures['frames']:,}"]
            rows.append([label, *sizes, *seconds, f"{figures['peak_mib']:,}", f"{figures['page_mib']:.1f}"])
    head = ["case", "vertices", "frames", "read", "move", "write", "preview", "peak memory", "page"]
    slopes = "; ".join(
        f"{LARGE_CASES[case]}: {slope['all']:.2f} (move {slope['moved']:.2f}, memory {slope['peak_mib']:.2f})"
        for case, slope in report["exponents"].items()
    )
    return (
        f"{markdown_table(head, rows)}\n\nSeconds of processor time; memory and page in MiB. "
        f"Fitted exponents over the sizes above: {slopes}. {' '.join(map(_growth, report['growth'].values()))} "
        f"Measured at commit {' and '.join(commits)}."
    )


def files() -> str:
    """Return the table of files that others have made, from benchmarks/files.json (research/measure_files.py)."""
    verdicts: dict[str, list[str]] = {}
    for file in figures_of("benchmarks/files")["files"]:
        verdicts.setdefault(file["maker"], []).append(file["verdict"])
    verdicts["all"] = [verdict for of in verdicts.values() for verdict in of]
    columns = ("right", "refused", "wrong")
    counts = {maker: [len(of), *(of.count(verdict) for verdict in columns)] for maker, of in verdicts.items()}
    rows = [[maker, *(str(count or "") for count in of)] for maker, of in counts.items()]
    return markdown_table(["made by", "files", *columns], rows)


def contacts() -> str:
    """Return the table of hands that touch the own body, of held-out characters, from benchmarks/contacts.json."""
    report = figures_of("benchmarks/contacts")
    rows = []
    for kind, label in (("everyday", "everyday contacts"), ("clips", "clips")):
        for group, of in report["results"][f"val {kind}"].items():
            row = [f"{label}, {group} ({of['characters']})"]
            for metric, scale in (("contact", 1), ("penetration", 100)):
                known = f"{metric} ours" in of
                for key in ("driving", "copied", "ours"):
                    row.append(f"{scale * of[f'{metric} {key}']:.2f}" if known else "")
            rows.append(row)
    head = ["motions, characters by girth", "contact: driving", "copied", "`--contacts`"]
    table = markdown_table([*head, "penetration: driving", "copied", "`--contacts`"], rows)
    return (
        f"{table}\n\nContact error in cm of a person of 1.75 m, penetration in % of the surface of hands and forearms. "
        f"{measured(report)}"
    )


def _growth(figures: dict) -> str:
    """Return a sentence on how time and memory grow in vertices or frames."""
    linear = "linear" if figures["linear"] else "more than linear"
    flat = (
        ""
        if figures["in"] == "vertices"
        else " (flat: at most 0.1): " + ("flat" if figures["memory_flat"] else "growing")
    )
    missing = " and ".join(f"{size:,}" for size in figures["missing"])
    return (
        f"**In {figures['in']}** the time has the exponent {figures['exponent']:.2f}, and "
        f"{figures['exponent_largest']:.2f} between the two largest sizes (linear: at most 1.05): {linear}. "
        f"Memory that is not a page of a file has the exponent {figures['memory_exponent']:.2f}{flat}."
        + (f" Not measured yet: {missing} {figures['in']}." if missing else "")
    )


def live(part: str) -> str:
    """Return a table of live sessions, from benchmarks/live.json: their errors, or times and memory."""
    report = figures_of("benchmarks/live")
    origin = measured(report)
    if part == "errors":
        lines = {
            "error, prepared with 1 frame": "1",
            "with 2": "2",
            "with 4": "4",
            "with 16": "16",
            "error of `animate` for the whole clip, `ground=False`": "animate_unplanted",
            "error of `animate`": "animate",
            "soles slide, live": "skate_live",
            "soles slide, `animate`": "skate_animate",
            "the driving's soles slide": "skate_driving",
        }
        figures = report["prepared_with"]
        rows = [
            [label, *(_figure(figures[body][key]) if key in figures[body] else "-" for body in figures)]
            for label, key in lines.items()
        ]
        head = ["", *(f"{report['pairs']} pairs: {body}" for body in figures)]
        return f"{markdown_table(head, rows)}\n\n{origin}"
    assert part == "speed"
    row = [_ms(report["latency_ms"][key]) for key in ("p50", "p90", "p99", "max")]
    memory = report["memory_mib"]
    return (
        f"{markdown_table(['a frame, median', '90 %', '99 %', 'slowest'], [row])}\n\n"
        f"Both meshes have {report['vertices']:,} vertices; preparing took {report['prepare_s']:.1f} s with "
        f"{report['prepared_frames']} frames. {report['over_5_ms']:,} of {report['frames']:,} frames took more than "
        f"5 ms. The process had {memory['start']:.0f} MiB before them and {memory['end']:.0f} MiB after. {origin}"
    )


def rigs() -> str:
    """Return the table of retargeting on own rigs, from docs/rigs.json."""
    report = figures_of("docs/rigs")
    keys = {
        "limbs, degrees": "limb_deg",
        "ends of limbs": "end_effector",
        "heights of soles": "sole_height",
        "feet that agree on contact": "touching",
        "soles slide": "skate",
        "the driving's": "skate_driving",
    }
    rows = [
        [group.replace("_", " "), *(_median_and_p90(figures.get(key)) for key in keys.values())]
        for group, figures in report["results"].items()
    ]
    head = f"{report['pairs']} pairs of {report['characters']} characters with {report['clips']} clips of other makers"
    failed = f"{len(report['failed'])} raised an exception, {report['upside_down']} are upside down"
    return (
        f"{head}: {failed}. Medians, and 90th percentiles in brackets: angle between the directions of limbs; distance "
        "of wrists from shoulders and ankles from hips, over the length of the limb; difference of the heights of "
        "soles, over the leg; share of feet; speed of soles while the driving's stand, in heights a second. “copied "
        "rotations” are the same pairs as “clips with a rig”, with each joint's rotation copied from its namesake as "
        "one does by hand.\n\n"
        f"{markdown_table(['', *keys], rows)}\n\n{measured(report)}"
    )


def own_clips() -> str:
    """Return the table of files whose own clips were played through the command, from docs/rigs.json."""
    report = figures_of("docs/rigs")["own"]
    rows = [_own_row(row) for row in report["files"]]
    head = ["file", "joints", "clips", "a person's rig by name", "largest error", "all else unchanged"]
    return f"{markdown_table(head, rows)}\n\n{measured(report)}"


def unnamed_rigs() -> str:
    """Return the table of characters whose joints were found without their names, from docs/rigs.json."""
    report = figures_of("docs/rigs")["unnamed"]
    head = ["pack (split)", "characters", "not used", "all limb joints right", "joints right"]
    rows = [
        [pack, str(row["characters"]), str(row["refused"]), str(row["all limbs"]), f"{row['found']} of {row['joints']}"]
        for pack, row in report["results"].items()
    ]
    return f"{markdown_table(head, rows)}\n\n{measured(report)}"


def _own_row(row: dict) -> list[str]:
    """Return the cells of a file: FBX has no bytes to compare, compressed files are written without compression."""
    error = "-" if row["error"] is None else f"{row['error']:.0e}" if row["error"] else "0"
    changed = "no: " + ", ".join(row["lost"]) if row.get("lost") else "yes"
    changed = "-" if "lost" not in row else f"{changed}, uncompressed" if row["compressed"] else changed
    person = "yes" if row["person"] else "no: " + row["reason"].partition(":")[0].partition(";")[0]
    return [f"`{row['file']}`", str(row["joints"]), str(row["clips"]), person, error, changed]


def _median_and_p90(figure: dict[str, float] | None) -> str:
    return "-" if figure is None else f"{figure['median']:.2g} ({figure['p90']:.2g})"


def _ms(value: float | None) -> str:
    return "-" if value is None else f"{_figure(value)} ms"


def _both(seen: float | None, unseen: float | None) -> str:
    return f"{_figure(seen)} / {_figure(unseen)}"


def _figure(value: float | None) -> str:
    if value is None:
        return "not measured"
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def formats(part: str) -> str:
    """Return a table of the page of formats."""
    return {"errors": errors_table, "limits": limits_table, "memory": memory_table}[part]()


def errors_table() -> str:
    """Return the largest errors of each format in Blender, from docs/formats.json (written by `make clients`)."""
    report = figures_of("docs/formats")
    rows = []
    for suffix, figures in sorted(report["formats"].items()):
        ours = max((error for kind, error in figures.items() if kind.endswith("in Blender")), default=None)
        errors = (ours, figures.get("Blender's, read"))
        rows.append([suffix, *("" if error is None else f"{error:.1g}" for error in errors)])
    made = report["provenance"]
    table = markdown_table(["format", "our files, in Blender", "Blender's files, read here"], rows)
    return f"{table}\n\nMeasured at commit {made['commit']} with {made['client']}."


def limits_table() -> str:
    """Return the largest numbers that are read from one file."""
    found = [value for value in vars(budgets).values() if isinstance(value, budgets.Budget)]
    rows = [[row.things, f"{row.largest:,}", f"{row.per_byte:.3g}" if row.per_byte else ""] for row in found]
    return markdown_table(["one file has at most", "number", "or, if that is more, for each byte of the file"], rows)


def memory_table() -> str:
    """Return the peak memory of converting a long clip and a tenth of it, from benchmarks/long_clip.json."""
    report = figures_of("benchmarks/long_clip")
    short, long = report["frames"] // 10, report["frames"]
    rows = []
    for name, figures in report["formats"].items():
        cells = [figures[str(count)][key] for key in ("write_mib", "read_mib") for count in (short, long)]
        cells.append(figures[str(long)]["size_mib"])
        rows.append([name, *(f"{cell:,.0f}" for cell in cells)])
    head = ["format", f"write {short:,}", f"{long:,}", f"read {short:,}", f"{long:,}", "size"]
    return (
        f"Clips of {report['vertices']:,} vertices, {short:,} or {long:,} frames; peak memory and file size in MiB:\n\n"
        f"{markdown_table(head, rows)}\n\n{measured(report)}"
    )


def pythons() -> str:
    """Return the table of Python and NumPy versions, from benchmarks/pythons.json."""
    report = figures_of("benchmarks/pythons")
    rows = []
    for row in report["rows"]:
        done = f"{row['distance_mm']:g} mm" if row["ok"] else f"no: {row['error'].removeprefix('ERROR: ')}"
        rows.append([row["python"], *(row.get(name, "") for name in ("numpy", "scipy", "onnxruntime")), done])
    head = ["Python", "NumPy", "SciPy", "onnxruntime", "largest distance to the first row"]
    return markdown_table(head, rows)


def batch_figures() -> str:
    """Return the table of what batches cost, from benchmarks/batch.json."""
    report = figures_of("benchmarks/batch")
    one, two, small = report["workers"]["1"], report["workers"]["2"], report["small"]
    identity, disk = report["identity"], report["identity"]["disk"]
    rows = [
        ["`mimesh animate` as a command for each pair", f"{report['command']:.2f} s"],
        ["`mimesh batch`, one worker", f"{one['cpu_seconds_a_job']:.2f} s"],
        ["the same, two workers", f"{two['cpu_seconds_a_job']:.2f} s"],
        ["`animate` in Python, clip with joints: nothing kept, all kept", _kept(identity["joints"])],
        ["the same, clip of a mesh without joints", _kept(identity["mesh"])],
        ["predicting an identity, reading it from disk", f"{disk['predict']:.2f} s, {disk['read']:.3f} s"],
        [f"a small job (`transfer -m copy`), of {small['jobs']}", f"{small['cpu_seconds_a_job']:.2f} s"],
        ["memory of that worker, first tenth and last", _memory(small)],
        [f"memory of a worker, {one['jobs']} jobs of `mime`", _memory(one)],
    ]
    rows += [
        [f"wall time of {one['jobs']} jobs, one worker and two", f"{one['seconds']:.0f} s, {two['seconds']:.0f} s"],
        ["speed-up by the second worker", f"{report['speed_up']:.2f}"],
    ]
    pairs = f"{report['identities']} identities of 9,564 vertices, {report['drivings']} clips of about 60 frames"
    where = f"Measured at commit {report['commit']}, {report['machine']}, with a load of {report['load']} at the start."
    if "memory_mib_in_1000_jobs" in small:
        rows.insert(8, ["growth of that memory in 1,000 jobs", f"{small['memory_mib_in_1000_jobs']:+.1f} MiB"])
    what = "Times are processor time for a job, if they are not wall time."
    return f"{markdown_table([pairs, ''], rows)}\n\n{what} {where}"


def batch_plan() -> str:
    """Return the arithmetic of a million clips a day, from benchmarks/batch.json."""
    report = figures_of("benchmarks/batch")
    one, kept = report["workers"]["1"], report["identity"]["mesh"]
    clips, used, per_machine, price = 1_000_000, 0.7, 16, 0.05
    seconds, size = one["cpu_seconds_a_job"], one["output_mib"] / one["jobs"]
    saved = kept["alone"] - kept["identity_and_driving_kept"]
    hours = clips * seconds / 3600
    cores = hours / 24 / used
    machines = math.ceil(cores / per_machine)
    rows = [
        ["processor time of a clip, all included", f"{seconds:.2f} s"],
        ["core hours", f"{clips:,} × {seconds:.2f} s / 3,600 = {hours:,.0f} h"],
        [f"cores, {used:.0%} of them busy", f"{hours:,.0f} h / 24 h / {used} = {cores:.0f}"],
        [f"machines of {per_machine} cores", f"{machines}"],
        ["memory of a machine", f"{per_machine} × {one['memory_mib_last']:.0f} MiB = "
         f"{per_machine * one['memory_mib_last'] / 1024:.1f} GiB"],
        ["results", f"{clips:,} × {size:.2f} MiB = {clips * size / 2**20:.2f} TiB, "
         f"{clips * size / 86400:.0f} MiB a second"],
        ["price, if a core hour costs P", f"{hours:,.0f} × P; P = {price}: {hours * price:,.0f}"],
        ["if no two clips share identity or driving", f"{clips:,} × ({seconds:.2f} s + {saved:.2f} s) / 3,600 = "
         f"{clips * (seconds + saved) / 3600:,.0f} core hours"],
    ]  # fmt: skip
    return markdown_table(["a million clips a day", ""], rows)


def _kept(figures: dict[str, float]) -> str:
    return f"{figures['alone']:.2f} s, {figures['identity_and_driving_kept']:.2f} s"


def _memory(figures: dict[str, float]) -> str:
    return f"{figures['memory_mib_first']:.0f} MiB, {figures['memory_mib_last']:.0f} MiB"


def command_reference() -> str:
    """Return one Markdown section per command: description, usage, arguments, and options with their defaults."""
    group = command_line()
    context = typer.Context(group, info_name="mimesh")
    return "\n\n".join(_section(command, context) for command in group.commands.values())


def _section(command, parent) -> str:
    context = typer.Context(command, info_name=command.name, parent=parent)
    usage = " ".join(command.collect_usage_pieces(context)).replace("{", "").replace("}", "")
    parts = [f"## mimesh {command.name}", _text(command.help), f"```text\nmimesh {command.name} {usage}\n```"]
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option"]
    if arguments:
        parts.append(
            markdown_table(["takes", ""], [[f"`{p.metavar or p.name.upper()}`", _text(p.help)] for p in arguments])
        )
    parts.append(markdown_table(["option", "", "unless given"], [_option(p) for p in options]))
    return "\n\n".join(part for part in parts if part)


def _option(option) -> list[str]:
    """Return the row of an option: names and value, help, default."""
    names = ", ".join(f"`{name}`" for name in (*option.opts, *option.secondary_opts))
    takes = "" if option.is_flag else f" `{option.metavar or option.type.name.upper().split()[0]}`"
    return [names + takes, _text(option.help), _default(option)]


def _default(option) -> str:
    if option.default is None or option.default == "" or option.default == []:
        return "required" if option.required else ""
    if option.is_flag:
        return f"`{(option.opts if option.default else option.secondary_opts)[0]}`" if option.secondary_opts else ""
    return f"`{option.default}`"


def _text(text: str | None) -> str:
    """Return a help text as the content of a table cell; vertical bars would end the cell."""
    return (text or "").replace("|", "\\|").strip()


INSERTS = {
    "batch": batch_figures,
    "contacts": contacts,
    "plan": batch_plan,
    "large": large,
    "live": live,
    "formats": formats,
    "pythons": pythons,
    "models": models,
    "card": card,
    "table": table,
    "speed": speed,
    "rigs": rigs,
    "ownclips": own_clips,
    "unnamed": unnamed_rigs,
    "commands": command_reference,
    "files": files,
    "foundrigs": found_rigs,
}
"""WHAT of a mark -> function that returns its Markdown."""
