"""The style sheet of the page: for wide and narrow screens, light and dark, and for paper."""

from vpp_fmu.app.report.style import FONT, SCHEME

_PAGE = {
    "paper": ("#ffffff", "#14191f"),
    "ink": ("#1f2933", "#e4e9ee"),
    "quiet": ("#5f6c7b", "#9aa7b4"),
    "line": ("#d9dfe5", "#36404a"),
    "grid": ("#e8ecef", "#262e36"),
    "axis": ("#9aa5b1", "#5d6975"),
    "hovered": ("#f5f7f9", "#1d242b"),
    "strong": ("#ffffff", "#10151a"),
    "warning": ("#fdf6ec", "#2b2317"),
}
"""Colours of the page by name, light and dark; `strong`: letters on the strongest colours of a heat map."""


def _colours(which: int) -> str:
    figures = {name: (light, dark) for light, (name, dark) in SCHEME.items()}
    return " ".join(f"--{name}: {both[which]};" for name, both in (_PAGE | figures).items())


_MARKS = """
* { box-sizing: border-box; }
html { color-scheme: light dark; -webkit-text-size-adjust: 100%; }
body { margin: 0; background: var(--paper); color: var(--ink); line-height: 1.5; font-size: 16px; }
main, footer { max-width: 1100px; margin: 0 auto; padding: 0 24px; }
header { padding: 32px 0 8px; }
.source { font-size: 14px; color: var(--quiet); margin: 0 0 4px; }
h1 { font-size: 28px; line-height: 1.25; margin: 0 0 12px; font-weight: 650; letter-spacing: -0.01em; overflow-wrap: anywhere; }
h2 { font-size: 20px; line-height: 1.3; margin: 48px 0 8px; padding-top: 14px; border-top: 1px solid var(--line);
  overflow-wrap: anywhere; }
h3 { font-size: 16px; line-height: 1.35; margin: 0 0 6px; font-weight: 600; overflow-wrap: anywhere; text-wrap: balance; }
p { margin: 0 0 10px; max-width: 78ch; overflow-wrap: anywhere; }
pre { margin: 0 0 10px 2ch; overflow-x: auto; font-size: 15px; }
nav { margin: 18px 0 0; font-size: 14px; display: flex; flex-wrap: wrap; gap: 4px 20px; }
nav a { color: var(--after); text-decoration: none; }
nav a:hover { text-decoration: underline; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(230px, 1fr)); gap: 12px; margin: 16px 0 0; }
.tile { border: 1px solid var(--line); border-top: 3px solid var(--after); border-radius: 4px; padding: 12px 16px; min-width: 0;
  overflow-wrap: anywhere; }
.label { font-size: 13px; color: var(--quiet); }
.value { font-size: 23px; line-height: 1.3; font-weight: 600; font-variant-numeric: tabular-nums; }
.small { font-size: 13px; line-height: 1.4; color: var(--quiet); }
figure { margin: 28px 0 32px; }
figcaption, caption { font-size: 14px; color: var(--quiet); text-align: left; }
figcaption { margin-top: 2px; max-width: 100ch; overflow-wrap: anywhere; }
caption { padding-bottom: 6px; max-width: min(100ch, calc(100vw - 32px)); }
figcaption b, caption b { color: var(--ink); }
.table { margin: 28px 0 32px; overflow-x: auto; }
table { border-collapse: collapse; font-size: 14px; min-width: 50%; }
th, td { padding: 5px 14px; text-align: left; border-bottom: 1px solid var(--line); vertical-align: top; }
th { border-bottom: 2px solid var(--axis); font-weight: 600; vertical-align: bottom; }
tbody tr:hover { background: var(--hovered); }
.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
aside { border-left: 4px solid var(--before); background: var(--warning); padding: 12px 16px 2px; margin: 20px 0; }
footer { margin-top: 56px; padding-top: 12px; padding-bottom: 32px; font-size: 13px; color: var(--quiet); }

.plot { position: relative; width: 100%; }
.keys { display: flex; flex-wrap: wrap; align-items: center; gap: 2px 16px; font-size: 13px; margin: 0 0 2px; }
.key { all: unset; display: inline-flex; align-items: center; gap: 6px; cursor: pointer; padding: 2px 0; max-width: 100%;
  line-height: 1.3; }
.key span { overflow-wrap: anywhere; }
.key svg { flex: none; }
.key:focus-visible { outline: 2px solid var(--after); }
.key.off { opacity: 0.4; text-decoration: line-through; }
.scale { display: inline-flex; align-items: center; gap: 8px; white-space: pre; font-variant-numeric: tabular-nums; }
.ramp { width: min(160px, 30vw); height: 12px; border-radius: 2px; border: 1px solid var(--line); }
.sheet { overflow-x: auto; overflow-y: hidden; }
.sheet svg { display: block; font-size: 12px; touch-action: pan-x pan-y; user-select: none; -webkit-user-select: none; }
.sheet text { fill: var(--ink); white-space: pre; }
.words { min-width: 18ch; }
.prose { min-width: 30ch; }
.name { white-space: nowrap; }
.sheet .tick { fill: var(--quiet); font-variant-numeric: tabular-nums; }
.sheet .row { fill: var(--ink); }
.sheet .row, .sheet .tick { paint-order: stroke; stroke: var(--paper); stroke-width: 3px; stroke-linejoin: round; }
.sheet .title { font-size: 13px; }
.sheet .heading { font-size: 12px; }
.sheet .small { font-size: 11px; fill: var(--ink); }
.sheet .small.strong { fill: var(--strong); }
.ground { fill: none; }
.grid, .axis, .zero { fill: none; stroke: var(--grid); shape-rendering: crispEdges; }
.axis { stroke: var(--axis); }
.zero { stroke: var(--axis); }
.line { fill: none; stroke-linejoin: round; }
.guide { stroke: var(--axis); fill: none; pointer-events: none; }
.drag { fill: var(--veil); stroke: var(--after); pointer-events: none; }
.tip { position: absolute; z-index: 2; pointer-events: none; background: var(--paper); border: 1px solid var(--axis);
  border-radius: 3px; padding: 4px 8px; font-size: 12px; line-height: 1.45; max-width: min(360px, 90%); width: max-content;
  font-variant-numeric: tabular-nums; opacity: 0.96; }
.tip[hidden] { display: none; }
.tip i { display: inline-block; width: 9px; height: 9px; border-radius: 2px; margin-right: 6px; }
.hint { font-size: 13px; color: var(--quiet); margin: 10px 0 0; }
@media (hover: none) { .hint { display: none; } }

@media (max-width: 600px) {
  main, footer { padding: 0 16px; }
  header { padding-top: 20px; }
  h1 { font-size: 23px; }
  .tiles { grid-template-columns: 1fr 1fr; gap: 8px; }
  .tile { padding: 8px 10px; }
  .value { font-size: 18px; }
  th, td { padding: 5px 9px; }
}
@page { size: A4; margin: 15mm; }
@media print {
  body { font-size: 10.5pt; print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  main, footer { padding: 0; max-width: none; }
  header { padding-top: 0; }
  nav, .hint { display: none; }
  .tiles { grid-template-columns: repeat(4, 1fr); }
  h2, main > p { break-after: avoid; }
  figure, .tile, tr, aside { break-inside: avoid; }
}
"""

SHEET = (
    f":root {{ {_colours(0)} }}\n@media screen and (prefers-color-scheme: dark) {{ :root {{ {_colours(1)} }} }}\n"
    f"body {{ font-family: {FONT}; }}{_MARKS}"
)
