"""`make test-energy`: how often the intervals hold the truth, as tables in docs/energy.md.

    python -m tests.energy [--runs N] [--only WORDS] [-o FILE]

Every case is N scripted discharges (2,000) read by the agent's own code. The exit code is 1 when a case misses
its bounds: 93.5 to 96.5 % without drift, at least 92 % with it, stage powers within 2 % in the mean.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from .coverage import CASES, COARSE, Coverage, coverage
from .sweep import SWEEPS, SweepCoverage, sweep_coverage

TARGET = Path(__file__).resolve().parents[2] / "docs" / "energy.md"
BEGIN, END = "<!-- coverage: written by `make test-energy` -->", "<!-- end of coverage -->"
FULL_RUNS, SWEEP_SHARE = 2000, 10  # a sweep takes as long as this many measurements


def main(arguments: Sequence[str]) -> int:
    """Runs the cases, prints the tables as they grow, and puts them into the file."""
    parser = argparse.ArgumentParser(prog="python -m tests.energy", description="Coverage of the energy intervals.")
    parser.add_argument("--runs", type=int, default=FULL_RUNS, help=f"discharges a case ({FULL_RUNS})")
    parser.add_argument("--only", default="", help="cases whose group and name contain this; then no file is written")
    parser.add_argument("-o", type=Path, default=TARGET, help="the file whose tables are replaced")
    options = parser.parse_args(arguments)
    started = time.monotonic()
    missed = []
    lines: list[str] = []

    def tell(*text: str) -> None:
        lines.extend(text)
        print("\n".join(text), flush=True)

    with ProcessPoolExecutor(os.cpu_count()) as pool:
        tell(*COVERAGE_HEAD)
        for case in (case for case in CASES if options.only in f"{case.group} {case.name}"):
            row = coverage(case, options.runs, pool)
            missed += [] if row.within_bounds else [case.name]
            tell(coverage_line(row))
        tell("", *SWEEP_HEAD)
        for sweep in (sweep for sweep in SWEEPS if options.only in f"sweep {sweep.name}"):
            result = sweep_coverage(sweep, max(20, options.runs // SWEEP_SHARE), pool)
            missed += [] if result.within_bounds else [sweep.name]
            tell(sweep_line(result))
    print(f"{time.monotonic() - started:.0f} s; outside the bounds: {', '.join(missed) or 'none'}")
    if not options.only:
        write(options.o, lines)
    return 1 if missed else 0


COVERAGE_HEAD = (
    "| | case | runs | not resolvable | holds long-run J | holds J drawn | holds net J | half-width | bias |",
    "|---|---|---|---|---|---|---|---|---|",
)
SWEEP_HEAD = (
    "| sweep | runs | stage | true W | `regressed` W | interval holds | `equation_2` W | prices that hold |",
    "|---|---|---|---|---|---|---|---|",
)


def coverage_line(row: Coverage) -> str:
    """One row of the first table."""
    unresolved = f"{100 * (1 - row.resolved / row.runs):.1f} %"
    if row.case.group == COARSE and not row.resolved:
        return f"| {row.case.group} | {row.case.name} | {row.runs} | {unresolved} | | | | | |"
    net = "" if row.net is None else f"{100 * row.net:.1f} %"
    return (
        f"| {row.case.group} | {row.case.name} | {row.runs} | {unresolved} | {100 * row.long_run:.1f} % "
        f"| {100 * row.drawn:.1f} % | {net} | {100 * row.half_width:.2f} % | {100 * row.bias:+.2f} % |"
    )


def sweep_line(result: SweepCoverage) -> str:
    """The rows of one sweep."""
    return "\n".join(
        f"| {result.sweep.name if not row else ''} | {result.runs if not row else ''} | {name} | {watts:.1f} "
        f"| {result.fitted_w[name]:.2f} | {100 * result.holds[name]:.1f} % | {result.equation_2_w[name]:.2f} "
        f"| {f'{100 * result.priced:.1f} %' if not row else ''} |"
        for row, (name, watts, _) in enumerate(result.sweep.machine.stages)
    )


def write(target: Path, lines: list[str]) -> None:
    """Replaces what stands between the markers; a file without them is left alone, with a word."""
    text = target.read_text(encoding="utf-8") if target.is_file() else ""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        print(f"{target} has no place for the tables: a line {BEGIN} and a line {END}.", file=sys.stderr)
        return
    target.write_text(before + "\n".join([begin, "", *lines, "", end]) + after, encoding="utf-8")
    print(f"written to {target}")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
