"""The style sheets of the pages: light and dark; the report is 800 to 1920 pixels wide, or on paper."""

# Colours and type of both pages; Bokeh reads the colours of the text in the pictures from the page.
_PAGE = """
:root { color-scheme: light dark; --back: #fff; --text: #1b1b1b; --soft: #f3f4f6; --line: #8884; --note: #5c5c5c;
  --good: #00704f; --bad: #b34700; --blue: #0072B2; --picture: #4d4d4d; }
@media (prefers-color-scheme: dark) { :root { --back: #141414; --text: #e4e4e4; --soft: #202124; --note: #a5a5a5;
  --good: #35c79b; --bad: #ff9149; --blue: #56B4E9; --picture: #a3a3a3; } }
:root { --bokeh-base-font: system-ui, sans-serif; --bokeh-font-size: 15px; --bk-text-color: var(--picture);
  --bk-title-text-color: var(--picture); --bk-axis-label-text-color: var(--picture);
  --bk-major-label-text-color: var(--picture); --bk-label-text-color: var(--picture); }
body { font: 15px/1.45 system-ui, sans-serif; background: var(--back); color: var(--text); }
"""
#: The style sheets of the live page, and of a card of it.
LIVE = _PAGE + "@media (min-width: 900px) { body { margin: .4rem 1rem; } }"
CARD = """
:host { box-sizing: border-box; width: 100%; background: var(--soft); border-radius: 8px; padding: .5rem 1rem;
  margin: .3rem 0; }
"""
#: JavaScript that draws all pictures anew when the reader changes between light and dark.
REPAINT = """
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  for (const plot of Bokeh.index.query(view => view.model.type == "Figure")) plot.request_repaint()
})
"""
#: The style sheet of the report.
STYLE = (
    _PAGE
    + """
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1840px; padding: .8rem 1rem 3rem; }
h1 { font-size: 1.25rem; margin: 0 0 .2rem; overflow-wrap: anywhere; }
h2 { font-size: 1.2rem; margin: 1.6rem 0 .3rem; } h3 { font-size: .95rem; margin: .1rem 0 .2rem; }
p { margin: .25rem 0; } .note { color: var(--note); font-size: .85rem; }
.card { display: grid; grid-template-columns: minmax(220px, 1fr) 2.6fr; gap: 1rem; }
.card > *, .tile { background: var(--soft); border-radius: 8px; padding: .7rem 1rem; min-width: 0; }
.what { display: grid; grid-template-rows: auto auto minmax(110px, 1fr) auto; }
.card img { width: 100%; height: 0; min-height: 100%; image-rendering: pixelated; border-radius: 4px; }
.badge { display: inline-block; margin: 0; padding: .05rem .7rem; border-radius: 1rem; color: var(--back);
  background: var(--note); font-weight: 600; } .explained .badge { background: var(--good); }
.not_explained .badge { background: var(--bad); }
.headline { font-size: 1.3rem; line-height: 1.25; font-weight: 600; margin: .4rem 0; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .15rem .9rem; margin: .4rem 0 0; }
dt { color: var(--note); } dd { margin: 0; min-width: 0; overflow-wrap: anywhere; }
.card .tiles { grid-column: 1 / -1; display: grid; grid-template-columns: repeat(3, 1fr); gap: 1rem; padding: 0;
  background: none; }
.tile .number { font-size: 1.3rem; font-weight: 600; } .number span { white-space: nowrap; }
.tile table { width: 100%; font-size: .85rem; } .tile td { padding: .08rem .4rem .08rem 0; white-space: nowrap; }
.bar { width: 45%; } div.bar { width: 100%; background: var(--line); border-radius: 3px; }
.bar i { display: block; height: .75rem; background: #777; border-radius: 3px; min-width: 1px; }
.after .bar i, div.bar i { background: var(--blue); }
.curves { display: block; width: 100%; height: 2.5rem; margin-top: .3rem; border-left: 1px solid var(--line);
  border-bottom: 1px solid var(--line); }
.curves polyline { fill: none; stroke: #777; stroke-width: 2; vector-effect: non-scaling-stroke; }
.curves .after { stroke: var(--blue); } .curves .law { stroke-dasharray: 6 4; }
.curves .floor { stroke-dasharray: 2 4; }
.before td:first-child, .after td:first-child { font-weight: 600; }
nav { position: sticky; top: 0; z-index: 5; display: flex; flex-wrap: wrap; align-items: center; gap: .2rem .9rem;
  background: var(--back); border-bottom: 1px solid var(--line); padding: .3rem 0; margin-top: .8rem; }
nav a { color: inherit; } nav .choose { margin-left: auto; display: flex; align-items: center; gap: .5rem; }
section { scroll-margin-top: 5rem; } .panel { min-width: 0; }
.row { display: grid; grid-auto-flow: column; grid-auto-columns: minmax(0, 1fr); gap: .6rem 1rem; }
.row.ring { grid-template-columns: minmax(0, 2fr) minmax(0, 1fr); }
.scroll { overflow-x: auto; } summary { cursor: pointer; } details { margin: .4rem 0; }
.swatch { display: inline-block; width: .8rem; height: .8rem; border-radius: 2px; margin-right: .4rem; }
table { border-collapse: collapse; } section tr { border-bottom: 1px solid var(--line); }
section td, section th { padding: .15rem .8rem .15rem 0; text-align: right; vertical-align: top; }
section td:first-child, section th:first-child, section .left td, section .left th { text-align: left; }
@media (max-width: 1099px) { .row, .row.ring { grid-auto-flow: row; grid-template-columns: minmax(0, 1fr); }
  .tile .number { font-size: 1.05rem; } .bar { min-width: 3rem; } .curves, .curves + p { display: none; }
  .card { grid-template-columns: minmax(0, 1fr); gap: .7rem; } .card > *, .tile { padding: .5rem .6rem; }
  .card .tiles { gap: .7rem; } .what { grid-template: auto auto minmax(20px, 1fr) / 1fr 1.3fr; gap: 0 1rem; }
  .card img { grid-area: 1 / 2 / 4 / 3; min-height: 110px; } }
@media (max-width: 640px) { .card .tiles { grid-template-columns: minmax(0, 1fr); } }
@media print { nav { display: none; } body { max-width: none; font-size: 11px; }
  .panel, .card > * { break-inside: avoid; } h2 { break-after: avoid; } }
"""
)
