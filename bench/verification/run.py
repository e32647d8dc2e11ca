"""Run the full verification studies; write JSON, a Markdown table and plots beside this file.

    TLEDFACE_NUM_THREADS=1 python bench/verification/run.py [statics] [beams] [film] [-o DIR]

One thread is the faster choice for models as small as these on a busy machine. Without names all
studies run. A name given alone replaces its own rows and keeps the others'.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[1] / "tests" / "verification"))

from plots import draw_convergence, draw_film  # noqa: E402

import beams  # noqa: E402
import bodies  # noqa: E402
import film_theory  # noqa: E402
import film_waves  # noqa: E402
from tledface.examples import film  # noqa: E402

FORMS = ("physical", "joldes")


def row(study, case, got, expected, tolerance=None, *, upper=False, n=None, form="physical"):
    """One figure. With ``upper`` the figure itself must stay below ``tolerance``."""
    error = got / expected - 1
    met = None
    if tolerance is not None:
        met = bool(got <= tolerance) if upper else bool(abs(error) <= tolerance)
    return {
        "study": study,
        "case": case,
        "form": form,
        "n": n,
        "got": float(got),
        "expected": float(expected),
        "error": float(error),
        "tolerance": tolerance,
        "upper": upper,
        "met": met,
    }


class Rows(list):
    """Rows as they are found, each with the time since the one before."""

    def __init__(self):
        """Start the clock."""
        super().__init__()
        self._last = time.perf_counter()

    def add(self, *new):
        """Take rows that were found together."""
        now = time.perf_counter()
        for found in new:
            found["seconds"] = round((now - self._last) / len(new), 2)
            print(*(found[key] for key in ("study", "case", "form", "n", "got", "error")))
        self.extend(new)
        self._last = now


def statics():
    """Thick bodies against independent finite elements."""
    rows = Rows()
    refs = bodies.reference_structures()
    if refs is None:
        raise SystemExit("statics: the reference results are not on this machine")

    def cube(nu, strain, n, form):
        key = {-0.2: "-0.2", 1.0: "+1.0"}[strain]
        force, bulge, _ = refs["bonded_cube"]["nh1"][f"nu{nu}"][key]
        got = bodies.bonded_cube(n, nu, strain, hourglass=form)
        tolerance = {-0.2: 0.04, 1.0: 0.015}[strain] if (n, form) == (20, "physical") else None
        case = f"bonded cube {strain:+.0%}, nu {nu}"
        return [
            row("statics", case + ", force", got[0], force, tolerance, n=n, form=form),
            row("statics", case + ", bulge", got[1], bulge, n=n, form=form),
        ]

    for nu in (0.45, 0.49):
        for strain in (-0.2, 1.0):
            for form in FORMS:
                for n in (5, 10, 20):
                    rows.add(*cube(nu, strain, n, form))
    for g in (0.01, 0.1):
        tip = refs["cantilever"][f"g_fraction_{g}"]["tip"]
        for n in (5, 10, 20):
            rows.add(
                row(
                    "statics",
                    f"cantilever at {g} g, tip",
                    -bodies.cantilever(n, g)[1],
                    -tip[1],
                    0.01 if n == 20 else None,
                    n=n,
                ),
            )
    for form in FORMS:
        for n in (4, 10, 20, 30):
            rows.add(
                row(
                    "statics",
                    "column twisted by 60 degrees, nu 0.49, torque",
                    bodies.twisted_column(n, hourglass=form),
                    bodies.COLUMN_TORQUE,
                    {4: 0.06, 10: 0.012, 20: 0.004}.get(n) if form == "physical" else None,
                    n=n,
                    form=form,
                ),
            )
    return rows


def beam_studies():
    """Slender bodies against beam theory, and the time integration."""
    rows = Rows()
    for layers, tolerance in ((1, 0.04), (2, 0.01), (4, 0.01)):
        for nu in (0.3, 0.45, 0.49):
            for form in FORMS if layers < 4 else FORMS[:1]:
                rows.add(
                    row(
                        "beams",
                        f"10:1 cantilever over Timoshenko, nu {nu}",
                        beams.tip_over_timoshenko(layers, nu, hourglass=form),
                        1.0,
                        tolerance if form == "physical" else None,
                        n=layers,
                        form=form,
                    ),
                )
    for plane_strain in (True, False):
        for aspect in (0.5, 1.0, 2.0):
            for nu in (0.3, 0.45, 0.49):
                kind = "wide" if plane_strain else "narrow"
                rows.add(
                    row(
                        "beams",
                        f"{kind} strip rolled up by 180 degrees, boxes {aspect:g}:1, nu {nu}",
                        beams.rolled_moment(aspect, nu, plane_strain),
                        1.0,
                        0.03,
                        n=1,
                    ),
                )
    rows.add(row("beams", "first frequency, bar", beams.bar_frequency(), 1.0, 0.02))
    rows.add(
        row("beams", "first frequency, cantilever", beams.cantilever_frequency(), 1.0, 0.02),
    )
    for precision in ("single", "double"):
        kept = 1.0 + beams.energy_drift(precision=precision)
        case = f"energy kept over 100 000 undamped steps, {precision} precision"
        rows.add(row("beams", case, kept, 1.0, 0.01))
    errors = beams.step_errors()
    names = ("1/4 and 1/8", "1/8 and 1/16", "1/16 and 1/32")
    for (coarse, fine), name in zip(pairwise(errors), names, strict=True):
        rows.add(
            row("beams", f"error ratio of time steps of {name} h / c", coarse / fine, 4.0, 0.1),
        )
    return rows


def film_studies():
    """A film on a soft substrate against Biot's theory."""
    rows = Rows()
    for ratio, tabled in (
        (10.0, 0.10522),
        (24.57, 0.05893),
        (100.0, 0.02364),
        (300.0, 0.01148),
        (1000.0, 0.00517),
    ):
        rows.add(
            row(
                "film",
                f"theory, ratio {ratio:g}, critical strain",
                film_theory.onset(ratio)[1],
                tabled,
                1e-3,
            ),
        )
    cases = [(1, 1.0, 0.05), (2, 1.0, 0.05), (4, 1.0, 0.02), (1, 0.5, 0.12), (1, 2.0, 0.12)]
    for ratio in film.EXACT:
        for layers, aspect, tolerance in cases:
            for form in FORMS if layers == 1 and aspect == 1.0 else FORMS[:1]:
                rows.add(*waves(ratio, layers, aspect, tolerance, form))
    for voxel, most in ((0.5, None), (0.25, 2.2), (0.125, 1.3), (0.0625, 1.0)):
        for section in (True, False):
            rows.add(
                row(
                    "film",
                    f"0.02 mm corneum in {voxel} mm voxels, "
                    f"{'section' if section else 'blended'}, wavelength in mm",
                    film_waves.layered_onset(voxel * 1e-3, section)[0] * 1e3,
                    0.02 * film_theory.onset(1000.0)[0],
                    most if section else None,
                    upper=True,
                ),
            )
    for ratio in film.EXACT:
        for layers, aspect, tolerance in ((1, 1.0, 0.05), (1, 2.0, 0.12), (4, 1.0, 0.02)):
            if layers == 4 and ratio > 10.0:
                continue  # 40 000 elements and more for half a million steps
            rows.add(*shortening(ratio, layers, aspect, tolerance))
    return rows


def waves(ratio, layers, aspect, tolerance, form):
    """Neutral waves of the discrete equations."""
    wavelength, strain = film_waves.film_onset(ratio, layers, aspect, hourglass=form)
    return onset_rows("waves", ratio, layers, aspect, tolerance, form, wavelength, strain)


def shortening(ratio, layers, aspect, tolerance):
    """The shipped example, shortened until it wrinkles."""
    wavelength, strain = film.EXACT[ratio]
    wavelength *= film.THICKNESS
    model = film.strip(ratio, wavelength, layers=layers, aspect=aspect)
    run = film.shorten(
        model, wavelength, 1.3 * strain, step=strain / 50, device="native", stop_after_onset=True
    )
    found = run.wavelength / wavelength, run.onset / strain
    return onset_rows("shortened", ratio, layers, aspect, tolerance, "physical", *found)


def onset_rows(how, ratio, layers, aspect, tolerance, form, wavelength, strain):
    """Wavelength and strain, both over the exact ones."""
    case = f"{how}, ratio {ratio:g}, boxes {aspect:g}:1"
    judged = form == "physical"
    return [
        row(
            "film",
            case + ", wavelength",
            wavelength,
            1.0,
            tolerance if judged else None,
            n=layers,
            form=form,
        ),
        row("film", case + ", strain", strain, 1.0, 0.07 if judged else None, n=layers, form=form),
    ]


def table(rows):
    """Markdown of all rows."""
    names = ("study", "case", "form", "elements", "got", "expected", "error", "allowed", "met")
    lines = [f"| {' | '.join(names)} |", "|" + "---|" * len(names)]
    for r in rows:
        allowed = (
            ""
            if r["tolerance"] is None
            else (f"≤ {r['tolerance']:g}" if r["upper"] else f"{r['tolerance']:.1%}")
        )
        met = {None: "", True: "yes", False: "**no**"}[r["met"]]
        lines.append(
            f"| {r['study']} | {r['case']} | {r['form']} | {r['n'] or ''} | {r['got']:.5g} | "
            f"{r['expected']:.5g} | {r['error']:+.2%} | {allowed} | {met} |"
        )
    return "\n".join(lines) + "\n"


STUDIES = {"statics": statics, "beams": beam_studies, "film": film_studies}


def main():
    """Run what the command line asks for; 1 if a figure lies outside what is allowed."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("studies", nargs="*", metavar="STUDY", help=", ".join(STUDIES))
    parser.add_argument("-o", "--output", type=Path, default=HERE / "results")
    options = parser.parse_args()
    if unknown := set(options.studies) - set(STUDIES):
        parser.error(f"no study {', '.join(sorted(unknown))}; known: {', '.join(STUDIES)}")
    options.output.mkdir(parents=True, exist_ok=True)
    file = options.output / "verification.json"
    known = json.loads(file.read_text(encoding="utf-8")) if file.exists() else []
    for name in options.studies or STUDIES:
        rows = STUDIES[name]()
        known = [r for r in known if r["study"] != name] + rows
        file.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")
    known.sort(key=lambda r: list(STUDIES).index(r["study"]))
    (options.output / "verification.md").write_text(table(known), encoding="utf-8")
    draw_convergence(options.output / "convergence.png", known)
    draw_film(options.output / "film.png", known)
    missed = [r["case"] for r in known if r["met"] is False]
    print(f"{len(known)} figures, {len(missed)} outside what is allowed {missed or ''}")
    return 1 if missed else 0


if __name__ == "__main__":
    np.seterr(all="raise", under="ignore")
    sys.exit(main())
