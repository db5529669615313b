"""The style sheet of HTML reports: light and dark by the reader's setting, light on paper, no outside fonts."""

STYLE = """
:root { color-scheme: light dark; --ink: #1c2024; --soft: #5b6470; --paper: #ffffff; --card: #f5f6f8; --rule: #dde1e6;
  --before: #c98500; --after: #0072b2; --best: #009e73; --good: #0b7a4b; --care: #a15c00; --bad: #c02026;
  --link: #005a8c; }
@media (prefers-color-scheme: dark) { :root { --ink: #e8eaed; --soft: #a4adb8; --paper: #14171a; --card: #1e2226;
  --rule: #343a41; --before: #f0b429; --after: #56b4e9; --best: #35c99b; --good: #4fd19a; --care: #f5b04c;
  --bad: #ff7b7f; --link: #7cc4f2; } }
html { font-size: 15px; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 1rem/1.5 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
main { max-width: 1060px; margin: 0 auto; padding: 28px 24px 40px; }
h1 { font-size: 1.5rem; margin: 0 0 2px; }
h2 { font-size: 1.08rem; margin: 30px 0 4px; }
p { margin: 4px 0 8px; }
.soft, .explain, caption { color: var(--soft); }
.explain { font-size: .9rem; max-width: 76ch; }
.verdict { border-left: 8px solid var(--tone); background: var(--card); padding: 14px 18px; margin: 16px 0;
  border-radius: 4px; }
.verdict strong { font-size: 1.3rem; color: var(--tone); }
.good { --tone: var(--good); } .care { --tone: var(--care); } .bad { --tone: var(--bad); }
.note { --tone: var(--link); }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(13rem, 1fr)); gap: 12px; margin: 14px 0; }
.tile { background: var(--card); border-radius: 4px; padding: 10px 14px; }
.tile b { display: block; font-size: 1.18rem; white-space: nowrap; font-variant-numeric: tabular-nums; }
.tile span { color: var(--soft); font-size: .86rem; }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(26rem, 100%), 1fr)); gap: 20px;
  align-items: start; }
ul { padding-left: 1.2em; margin: 4px 0; } ul.columns { columns: 2 24rem; font-size: .9rem; }
li.fail::marker { color: var(--bad); content: "\\2716  "; }
li.caution::marker { color: var(--care); content: "\\25B2  "; }
li.note::marker { color: var(--soft); content: "\\2022  "; }
table { border-collapse: collapse; width: 100%; font-size: .87rem; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: 3px 8px; border-bottom: 1px solid var(--rule); white-space: nowrap; }
th { font-weight: 600; color: var(--soft); } td.words, th.words { text-align: left; white-space: normal; }
.wide td.words { min-width: 10rem; } .wide td:nth-child(2) { min-width: 24rem; }
td.name { font-family: ui-monospace, "DejaVu Sans Mono", monospace; text-align: left; }
.scroll { overflow-x: auto; }
svg.plot { width: 100%; height: auto; display: block; }
svg.inline { width: 8rem; height: .93rem; vertical-align: middle; }
svg text { fill: var(--ink); font-size: 12px; } svg text.small { font-size: 11px; fill: var(--soft); }
svg .grid { stroke: var(--rule); stroke-width: 1; } svg .line { fill: none; stroke-width: 2.2; }
svg .before { stroke: var(--before); } svg .after { stroke: var(--after); } svg .best { stroke: var(--best); }
svg .mark { stroke: var(--after); stroke-width: 1; opacity: .55; } svg .fill { fill: var(--after); opacity: .75; }
svg .whisker { stroke: var(--ink); stroke-width: 1; fill: none; }
nav { display: flex; flex-wrap: wrap; gap: 4px 18px; margin: 14px 0 0; font-size: .9rem; }
a { color: var(--link); } section { scroll-margin-top: 8px; }
caption { text-align: left; padding: 2px 0 6px; } thead th { white-space: normal; vertical-align: bottom; }
tbody th, tbody th.words { color: var(--ink); white-space: nowrap; }
figure { margin: 18px 0 6px; overflow-x: auto; } figcaption { color: var(--soft); font-size: .86rem; margin-top: 4px; }
svg.drawn { display: block; width: 100%; height: auto; margin: 0 auto; overflow: visible;
  stroke-linejoin: round; stroke-linecap: butt; }
svg.drawn text { font-family: inherit !important; }
figure img { max-width: 100%; height: auto; display: block; border-radius: 4px; }
.interactive, .hint { display: none; } .live .interactive { display: block; } .live .hint { display: inline; }
.live .still { display: none; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: 3px 18px; font-size: .9rem; overflow-wrap: anywhere; }
dt { color: var(--soft); } dd { margin: 0; }
footer { margin-top: 28px; color: var(--soft); font-size: .83rem; overflow-wrap: anywhere; }
@media print { :root { color-scheme: light; --ink: #000; --soft: #444; --paper: #fff; --card: #f3f3f3;
  --rule: #ccc;
  --before: #b37700; --after: #0072b2; --best: #009e73; --good: #0b7a4b; --care: #8a4f00; --bad: #b01c22; }
  @page { size: A4; margin: 11mm; }
  html { font-size: 9px; } .explain { max-width: none; } main { max-width: none; padding: 0; }
  nav, .live .interactive, .live .hint { display: none; } .live .still { display: block; }
  figure { break-inside: avoid; margin: 8px 0 4px; overflow: visible; } svg.drawn { min-width: 0 !important; }
  .scroll { overflow: visible; } .wide td.words { min-width: 0; } .wide td:nth-child(2) { min-width: 20rem; }
  * { -webkit-print-color-adjust: exact; print-color-adjust: exact; }
  h2 { margin-top: 12px; } h2, .explain { break-after: avoid; } th, td { padding: 1px 5px; }
  .pair { grid-template-columns: 1fr 1fr; }
  .tiles { grid-template-columns: repeat(4, 1fr); } svg, tr, .tile, .verdict { break-inside: avoid; } }
"""
