"""The report says what the result says, opens offline, and can be read by everybody."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import re
from html import unescape
from itertools import pairwise

import numpy as np
import pytest
from plotly.offline import get_plotlyjs

from support.pages import Page, book, unpacked, without_plotly
from support.report_sample import refused, sample
from trueplant.report import render
from trueplant.report.frame import HARMLESS
from trueplant.report.numbers import number, to_precision
from trueplant.report.style import DARK, LIGHT
from trueplant.result import (
    ControllerSettings,
    CurrentSettings,
    DetectedElement,
    Detection,
    FaceplateSettings,
    LoopMargins,
    LoopMetrics,
    LoopRetuning,
    LoopRobustness,
    Margins,
    MetricsOfBoth,
    Notation,
    Peak,
    ProposedSettings,
    Reason,
    Result,
    RetuningLimits,
    SystemPeaks,
    Trend,
)


@pytest.fixture(scope="module")
def result() -> Result:
    return sample()


@pytest.fixture(scope="module")
def page(result: Result) -> str:
    return render(result)


@pytest.fixture(scope="module")
def parsed(page: str) -> Page:
    return Page(without_plotly(page))


def test_verdict_is_the_first_thing_said(result, parsed):
    headings = [(tag, "".join(text)) for tag, _, text in parsed.elements if re.fullmatch("h[1-6]", tag)]
    assert headings[0] == ("h1", result.shift.replace(" %", "\u00a0%"))  # no line ends between the two
    assert parsed.by_id("headline") == result.headline.replace("->", "→")
    assert [tag for tag, _ in headings].count("h1") == 1


def test_an_unchanged_element_says_what_would_have_been_seen(result, page):
    unchanged = [e for e in result.elements if e.verdict == "unchanged"]
    assert unchanged
    for element in unchanged:
        assert (
            f"(a change of gain, lag or dead time by {100 * element.detectable_change:.2g} % would have been seen)"
            in page
        )
    assert page.count("would have been seen)") == len(unchanged)


def test_headings_skip_no_level(parsed):
    levels = [int(tag[1]) for tag, _, _ in parsed.elements if re.fullmatch("h[1-6]", tag)]
    assert all(after <= before + 1 for before, after in pairwise(levels))


def test_every_parameter_stands_in_the_table(result, parsed):
    rows = [text for _, text in parsed.all("tr")]
    for element in result.elements:
        assert any(f"{element.input} → {element.output}" in row and element.verdict in row for row in rows)
        for p in element.parameters:
            low, high = p.ci
            told = [
                number(p.model, 6),
                to_precision(p.plant, p.std_error),
                f"{to_precision(low, p.std_error)} to {to_precision(high, p.std_error)}",
                "changed" if p.changed else "unchanged",
            ]
            assert any(all(f" {part} " in f" {row} " for part in told) for row in rows), told


def test_formulas_of_model_plant_and_mismatch_stand_in_the_text(result, parsed):
    codes = [text for _, text in parsed.all("code")]
    for element in result.elements:
        assert {element.tf_model, element.tf_plant, element.tf_mismatch} <= set(codes)


def test_each_figure_has_an_alternative_with_numbers(page, parsed):
    plots = [a for a, _ in parsed.all("div") if a.get("class") == "plot"]
    steps, trends, bodes, residuals, condition = 4, 2, 4, 2 * (1 + 1 + 2), 1
    assert len(plots) == steps + trends + bodes + residuals + condition
    for plot in plots:
        assert plot["role"] == "img"
        assert re.search(r"\d", parsed.by_id(plot["aria-labelledby"]))
    assert {plot["id"] for plot in plots} == book(page)["figures"].keys()


def test_tables_have_captions_and_scopes(parsed):
    assert len(parsed.all("table")) == len(parsed.all("caption"))
    assert all(a.get("scope") in ("col", "row", "rowgroup") for a, _ in parsed.all("th"))


def test_landmarks_and_skip_link(parsed):
    for landmark in ("header", "nav", "main", "footer"):
        assert len(parsed.all(landmark)) == 1
    ids = {a["id"] for _, a, _ in parsed.elements if "id" in a}
    links = [a["href"] for a, _ in parsed.all("a")]
    assert links[0] == "#main"
    assert {link[1:] for link in links} <= ids


def test_ids_are_unique(parsed):
    ids = [a["id"] for _, a, _ in parsed.elements if "id" in a]
    assert len(ids) == len(set(ids))


def test_nothing_is_loaded_from_elsewhere(page):
    own = without_plotly(page)
    markup = re.sub(r"<script.*?</script>", "", own, flags=re.DOTALL)
    assert not re.search(r"\b(src|srcset|action|poster|data|ping)\s*=", markup)
    assert all(link.startswith("#") for link in re.findall(r'href="([^"]*)"', own))
    assert "http" not in own.replace("http-equiv", "")
    assert "url(" not in own
    assert "@import" not in own


def test_plotly_is_packed_as_it_is_installed(page):
    assert unpacked(page)["plotly"] == get_plotlyjs()
    assert len(page) < 2_200_000


def test_the_page_reads_the_letters_that_it_is_packed_in(page):
    """The script's digits are those of base 85, and none of them means something in HTML."""
    used = set("".join(re.findall(r'<script type="application/gzip"[^>]*>(.*?)</script>', page, re.DOTALL)))
    digits = [base64.b85encode(k.to_bytes(4, "big")).decode()[-1].translate(HARMLESS) for k in range(85)]
    script = re.search(r"<script>(.*?)</script>", page, re.DOTALL)[1]
    assert re.search(r'letters = "([^"]*)"', script)[1] == "".join(digits)
    assert used <= set(digits)
    assert not used & set("<>&\"'`\\")


def test_a_page_without_figures_has_no_script():
    page = render(dataclasses.replace(sample(experiments=1), curves=None))
    assert "<script" not in page and "script-src 'none'" in unescape(page)
    assert len(page) < 300_000


def test_only_the_scripts_of_the_report_may_run(page):
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', page)
    allowed = unescape(policy[1])
    assert allowed.startswith("default-src 'none'")
    assert "unsafe-eval" not in allowed
    scripts = [*re.findall(r"<script>(.*?)</script>", page, re.DOTALL), unpacked(page)["plotly"]]
    assert len(scripts) == 2
    for script in scripts:
        assert base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() in allowed


def test_figures_cannot_be_sent_to_a_server(page):
    own = without_plotly(page)
    assert "modeBarButtons:" in own
    assert "sendChartToCloud" not in own
    assert 'plotlyServerURL: ""' in own


def test_names_are_inert():
    evil = "<script>alert(1)</script>"
    result = sample((evil, 'a" onload="x'), ("</script><b>", "%{x} & more"), experiments=1)
    result = dataclasses.replace(result, notes=(Reason("x", f"note {evil}", evil),))
    text = render(result)
    own = without_plotly(text)
    assert evil not in own
    assert "<b>" not in own
    assert own.count("<script") == 1
    page = Page(own)
    assert not [a for _, a, _ in page.elements if "onload" in a]
    assert any(evil in caption for _, caption in page.all("figcaption"))
    titles = [a["text"] for f in book(text)["figures"].values() for a in f["layout"].get("annotations", [])]
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in titles
    assert not [t for t in titles if "%{" in t or "<" in t]


def test_refused_result_says_why():
    result = refused()
    page = Page(without_plotly(render(result)))
    assert page.all("h1")[0][1] == result.shift
    assert page.by_id("headline") == " ".join(result.headline.split())
    assert not page.all("script")
    assert any(result.reasons[0].message in text and "run_1.csv" in text for _, text in page.all("li"))
    assert not page.all("figure")


def test_unanswered_parameters_give_their_reason():
    result = refused(curves=True)
    page = Page(without_plotly(render(result)))
    rows = [text for _, text in page.all("tr")]
    for p in result.elements[0].parameters:
        assert any(number(p.model, 6) in row and f"not answered: {p.reason}" in row for row in rows)
    assert any("PV" in text for _, text in page.all("figcaption"))


def retuned_loop() -> LoopRetuning:
    """One loop for which one method proposes a smaller gain."""
    metrics = MetricsOfBoth(LoopMetrics(True, Ms=1.5), LoopMetrics(True, Ms=1.6))

    def settings(gain: float) -> tuple[ControllerSettings, FaceplateSettings]:
        own = ControllerSettings(form="ideal", Kc=gain, Ti=8.0, Td=0.0)
        return own, FaceplateSettings(gain, 8.0, 0.0, None, None)

    return LoopRetuning(
        input="reflux",
        output="top_temperature",
        controller_of="run_1",
        form="ideal",
        gain_unit="engineering",
        time_unit="min",
        notation=Notation("gain", "time", "ratio", "min"),
        limits=RetuningLimits(1.59, None, 0.95, 0.5, "twice today's"),
        assumptions=(),
        current=CurrentSettings(*settings(1.25), metrics, None),
        proposals=(ProposedSettings("simc", "", *settings(0.875), metrics, None),),
        recommended=None,
        reason="no proposal holds",
        price=None,
    )


@pytest.mark.parametrize("section", ["robustness", "controllers", "fit", "methods", "data"])
def test_sections_without_content_are_left_out(section, result):
    margins = Margins((LoopMargins("reflux", True, Ms=1.5),), (LoopMargins("reflux", True, Ms=1.6),))
    full = dataclasses.replace(result, robustness=LoopRobustness("run_1", margins, ()), controllers=(retuned_loop(),))
    nothing = None if section == "robustness" else type(getattr(full, section))()
    empty = dataclasses.replace(full, **{section: nothing, "curves": None})
    assert f'<section id="{section}"' in render(full)
    assert f'id="{section}"' not in render(empty)
    assert f'href="#{section}"' not in render(empty)


def test_peaks_and_settings_are_shown(result):
    margins = Margins((LoopMargins("reflux", True, Ms=1.5),), (LoopMargins("reflux", True, Ms=1.6),))
    peaks = {"model": SystemPeaks(True, True, RP=Peak(0.9728, 0.9728, 0.889))}
    full = dataclasses.replace(
        result, robustness=LoopRobustness("run_1", margins, (), peaks), controllers=(retuned_loop(),)
    )
    page = Page(without_plotly(render(full)))
    text = " ".join(text for _, text in page.all("section"))
    for value in ("0.973", "0.889", "1.25", "0.875", "simc"):
        assert value in text


@pytest.mark.parametrize(("scale", "told"), [(1e-6, "1.8e-6"), (1e6, "1.8e6")])
def test_extreme_gains_keep_their_digits(scale, told):
    result = sample(scale=scale, experiments=1)
    rows = [text for _, text in Page(without_plotly(render(result))).all("tr")]
    assert any(f"gain degC/% {told} " in row for row in rows)


def test_many_experiments_are_all_drawn():
    page = Page(without_plotly(render(sample(experiments=8))))
    titles = [text for _, text in page.all("h3")]
    assert all(f"run_{k}" in titles for k in range(1, 9))


def test_missing_set_points_are_said_and_not_drawn():
    text = render(sample(("flow",), ("valve",), experiments=1, with_setpoints=False))
    assert "no set-point was recorded" in text
    names = [t["name"] for f in book(text)["figures"].values() for t in f["data"]]
    assert "PV" in names
    assert "SP" not in names


def test_curves_that_hold_nothing_are_rendered(result):
    arrays = {f.name: getattr(result.curves, f.name) for f in dataclasses.fields(result.curves)}
    empty = {name: value[:0] for name, value in arrays.items() if isinstance(value, np.ndarray)}
    trend = Trend("nothing", np.zeros(0), *[np.zeros((0, 2))] * 5, ())
    found = result.curves.residuals[0]
    none = {name: getattr(found, name)[:0] for name in ("t", "e", "lags", "acf", "ccf_lags")}
    silent = dataclasses.replace(found, **none, ccf={"reflux": np.zeros(0)})
    curves = dataclasses.replace(result.curves, **empty, trends=(trend,), residuals=(silent,))
    parameter = dataclasses.replace(
        result.elements[0].parameters[0], model=None, ci=None, std_error=None, change_percent=None, p_adjusted=None
    )
    element = dataclasses.replace(result.elements[0], parameters=(parameter,), tf_model="", grade="")
    page = Page(without_plotly(render(dataclasses.replace(result, curves=curves, elements=(element,)))))
    assert "grade" not in "".join(text for _, text in page.all("tr"))
    assert any("No samples." in text for _, text in page.all("figcaption"))
    assert any("No response in model or plant: reflux, steam." in text for _, text in page.all("p"))


def test_long_records_stay_small(result):
    t = np.arange(1_000_000.0)
    rng = np.random.default_rng(1)
    y, u = rng.normal(size=(t.size, 2)), rng.normal(size=(t.size, 2))
    y[777_777, 0] = 99.0
    spans = tuple((float(k), float(k) + 1, "all", "spike") for k in range(0, 1_000_000, 500))
    trend = Trend("long", t, np.round(y), y, u, y + 0.1, y - 0.1, spans)
    long = dataclasses.replace(result, curves=dataclasses.replace(result.curves, trends=(trend,)))
    text = render(long)
    assert len(text.encode()) < 10_000_000
    drawn = next(f for f in book(text)["figures"].values() if f["data"][-1]["name"] == "OP")
    pv = next(trace for trace in drawn["data"] if trace["name"] == "PV")
    values = np.frombuffer(base64.b64decode(pv["y"]["bdata"]), dtype=pv["y"]["dtype"])
    assert values.size <= 4000
    assert values.max() == 99.0


def test_same_result_gives_the_same_text(page):
    assert render(sample()) == page


def _rgb(color: str) -> np.ndarray:
    return np.array([int(color[k : k + 2], 16) / 255 for k in (1, 3, 5)])


def _contrast(one: np.ndarray, other: np.ndarray) -> float:
    """Ratio of relative luminances as WCAG 2.2 defines it."""
    linear = [np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4) for c in (one, other)]
    faint, bright = sorted(float(c @ [0.2126, 0.7152, 0.0722]) for c in linear)
    return (bright + 0.05) / (faint + 0.05)


def _mixed(page: str, name: str, palette) -> np.ndarray:
    """A colour that the style mixes of ink and paper."""
    share = float(re.search(rf"--{name}: color-mix\(in srgb, var\(--ink\) (\d+)%, var\(--paper\)\)", page)[1]) / 100
    return share * _rgb(palette["ink"]) + (1 - share) * _rgb(palette["paper"])


@pytest.mark.parametrize("palette", [LIGHT, DARK], ids=["light", "dark"])
def test_text_and_lines_have_enough_contrast(palette, page):
    """WCAG 2.2: 4.5 to 1 for text (1.4.3) on both backgrounds, 3 to 1 for what is drawn (1.4.11)."""
    texts = {role: _rgb(palette[role]) for role in ("ink", "model", "plant", "points", "setpoint")}
    texts["quiet"] = _mixed(page, "quiet", palette)
    paper, shaded = _rgb(palette["paper"]), _mixed(page, "paper-2", palette)
    for role, color in texts.items():
        assert _contrast(color, paper) >= 4.5, role
        assert _contrast(color, shaded) >= 4.5, role
    for role in ("measured", "stem", "bound", "limit", "estimate", "before", "after", "axis"):
        assert _contrast(_rgb(palette[role]), paper) >= 3, role


def test_published_detectors_are_one_table_beside_the_verdicts():
    base = sample(experiments=1)
    first, second = base.elements[:2]

    def entry(name, flagged, refused=None):
        said = [
            DetectedElement(
                output=e.output,
                input=e.input,
                statistic=3.25 if e is flagged else 0.5,
                threshold=2.0,
                flagged=e is flagged,
                kind="dead time" if e is flagged else "",
            )
            for e in (first, second)
        ]
        return Detection(name, refused, "", () if refused else tuple(said))

    asked = [entry("stepwise", first), entry("cross-correlation", second), entry("one-class", None, "too few windows")]
    page = Page(
        without_plotly(
            render(dataclasses.replace(base, methods=dataclasses.replace(base.methods, detectors=tuple(asked))))
        )
    )
    found = [text for _, text in page.all("tr")]
    flag, calm = "▲ 3.25 > 2 (dead time)", "0.5 ≤ 2"
    for element, cells in ((first, f"{flag} {calm}"), (second, f"{calm} {flag}")):
        assert any(row.startswith(f"{element.input} → {element.output} {element.verdict} {cells}") for row in found)
    section = next(text for a, text in page.all("section") if a.get("id") == "methods")
    assert "one-class does not apply: too few windows" in section and section.count("Published detectors") <= 2
    assert "Published detectors" not in " ".join(t for _, t in Page(without_plotly(render(base))).all("section"))


def test_report_explains_itself():
    """It is sent on by itself: no file of this program's documentation is named, and the grades are said."""
    text = without_plotly(render(sample(experiments=1)))
    assert "docs/" not in text and ".md" not in text
    page = " ".join(t for _, t in Page(text).all("section"))
    assert "A, every parameter to within 10 %" in page and "p is the probability" in page


def test_model_has_as_many_digits_as_the_plant_is_known_to():
    from trueplant.report.tables import parameter_row
    from trueplant.result import Parameter

    def shown(model, error):
        return parameter_row(Parameter("gain", "", model, 13.0, error, (12.8, 13.2), 1.0, 0.5, 0.5, False), 50.0).model

    assert shown(12.900612345, 0.077) == "12.901"
    assert shown(12.900612345, 5.0) == "12.9"
    assert shown(12.8, 0.0001) == "12.8"
    assert shown(0.000123456789, 0.00001) == "0.000123"
    assert shown(0.0, 0.1) == "0" and shown(None, 0.1) == "–"


def test_a_long_list_of_left_out_spans_stays_closed_on_paper(result):
    """Printing opens what is folded; a list that would take pages is told by its summary."""
    (first, *others) = result.curves.trends
    spans = tuple((float(k), k + 0.5, "all", "spike") for k in range(9))
    long, short = (
        render(
            dataclasses.replace(
                result,
                curves=dataclasses.replace(result.curves, trends=(dataclasses.replace(first, excluded=kept), *others)),
            )
        )
        for kept in (spans, spans[:3])
    )
    assert '<details class="long">\n<summary>9 spans left out</summary>' in long
    assert "<details open>\n<summary>3 spans left out</summary>" in short
    assert '"details:not([open], .long)"' in long
