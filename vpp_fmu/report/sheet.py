"""How the page looks, on screen and on paper, and the few lines of script that draw its figures."""

from vpp_fmu.report.style import FONT

_MARKS = """
:root { --ink: #1f2933; --quiet: #5f6c7b; --line: #d9dfe5; --accent: #0072b2; }
* { box-sizing: border-box; }
html { color-scheme: light; }
body { margin: 0; background: white; color: var(--ink); line-height: 1.5; font-size: 16px; }
main, footer { max-width: 1100px; margin: 0 auto; padding: 0 24px; }
header { padding: 36px 0 8px; }
h1 { font-size: 28px; line-height: 1.25; margin: 0 0 12px; font-weight: 650; letter-spacing: -0.01em; }
h2 { font-size: 20px; line-height: 1.3; margin: 48px 0 8px; padding-top: 14px; border-top: 1px solid var(--line); }
p { margin: 0 0 10px; max-width: 78ch; overflow-wrap: anywhere; }
pre { margin: 0 0 10px 2ch; overflow-x: auto; font-size: 15px; }
nav { margin: 18px 0 0; font-size: 14px; display: flex; flex-wrap: wrap; gap: 4px 20px; }
nav a { color: var(--accent); text-decoration: none; }
nav a:hover { text-decoration: underline; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(230px, 1fr)); gap: 12px; margin: 16px 0 0; }
.tile { border: 1px solid var(--line); border-top: 3px solid var(--accent); border-radius: 4px; padding: 12px 16px; }
.label { font-size: 13px; color: var(--quiet); }
.value { font-size: 23px; line-height: 1.3; font-weight: 600; font-variant-numeric: tabular-nums; }
.small { font-size: 13px; line-height: 1.4; color: var(--quiet); }
figure { margin: 28px 0 32px; }
.plot { width: 100%; overflow: hidden; }
figcaption, caption { font-size: 14px; color: var(--quiet); text-align: left; }
figcaption { margin-top: 4px; max-width: 100ch; }
caption { padding-bottom: 6px; }
figcaption b, caption b { color: var(--ink); }
.table { margin: 28px 0 32px; overflow-x: auto; }
table { border-collapse: collapse; font-size: 14px; min-width: 50%; }
th, td { padding: 5px 14px; text-align: left; border-bottom: 1px solid var(--line); vertical-align: top; }
th { border-bottom: 2px solid #9aa5b1; font-weight: 600; vertical-align: bottom; }
tbody tr:hover { background: #f5f7f9; }
.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
aside { border-left: 4px solid #e08214; background: #fdf6ec; padding: 12px 16px 2px; margin: 20px 0; }
footer { margin-top: 56px; padding-top: 12px; padding-bottom: 32px; font-size: 13px; color: var(--quiet); }
@page { size: A4; margin: 15mm; }
@media print {
  body { font-size: 10.5pt; print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  main, footer { padding: 0; max-width: none; }
  header { padding-top: 0; }
  nav { display: none; }
  .tiles { grid-template-columns: repeat(4, 1fr); }
  h2, main > p { break-after: avoid; }
  figure, .tile, tr, aside { break-inside: avoid; }
  .modebar-container { display: none; }
}
"""

SHEET = f"body {{ font-family: {FONT}; }}{_MARKS}"

DRAW = """
const settings = {responsive: true, displaylogo: false, showSendToCloud: false, plotlyServerURL: "",
  modeBarButtonsToRemove: ["select2d", "lasso2d"], toImageButtonOptions: {scale: 2}};
function draw(name, figure) { Plotly.newPlot(name, figure.data, figure.layout, settings); }
// Paper is narrower than most windows, and plotly follows windows only: A4 less its margins is 680 CSS pixels wide.
function fit(change) { for (const plot of document.querySelectorAll(".plot")) Plotly.relayout(plot, change); }
addEventListener("beforeprint", () => fit({width: 680}));
addEventListener("afterprint", () => fit({width: null, autosize: true}));
"""
"""`draw` puts a figure into the element of that name. plotly 7 would offer a button that uploads the data: off."""
