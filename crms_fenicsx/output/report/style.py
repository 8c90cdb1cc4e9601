"""How a report looks, on a screen and on paper."""

STYLE = """
:root { --ink: #1b2733; --faint: #5b6876; --rule: #c9d1d9; --tint: #f3f6f9; --accent: #1f5a8c; }
* { box-sizing: border-box; }
body { font: 15px/1.5 "Helvetica Neue", Arial, "Liberation Sans", sans-serif; color: var(--ink);
  background: #fff; max-width: 68rem; margin: 0 auto; padding: 2rem 1.5rem 4rem; }
header { border-bottom: 3px solid var(--accent); margin-bottom: 1.5rem; padding-bottom: 1rem; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.3rem; margin: 2.6rem 0 .6rem; padding-bottom: .25rem;
  border-bottom: 1px solid var(--rule); color: var(--accent); }
h3 { font-size: 1.05rem; margin: 1.8rem 0 .4rem; }
p { max-width: 48rem; margin: .4rem 0 .8rem; }
dl.about { display: grid; grid-template-columns: max-content 1fr; gap: .1rem 1.2rem;
  margin: .8rem 0 0; }
dl.about dt { color: var(--faint); } dl.about dd { margin: 0; }
nav ol { columns: 2; margin: 0; padding-left: 1.3rem; } nav a { color: var(--accent); }
p.verdict { max-width: none; }
.verdict { border-left: 5px solid #2d7d46; background: #eef7f0; padding: .6rem .9rem;
  margin: 1rem 0; }
.verdict.doubtful { border-color: #b7791f; background: #fdf6e8; }
.verdict.failed { border-color: #b3261e; background: #fdeeed; }
.key { display: grid; grid-template-columns: repeat(3, 1fr); gap: .7rem;
  margin: 1rem 0; }
.key div { border: 1px solid var(--rule);
  border-top: 3px solid var(--accent); padding: .5rem .7rem; }
.key .value { font-size: 1.35rem; font-weight: 600; font-variant-numeric: tabular-nums;
  display: block; }
.key .what, .key .case { color: var(--faint); font-size: .84rem; display: block; }
.table { overflow-x: auto; margin: .8rem 0 1.3rem; }
table { border-collapse: collapse; font-size: .86rem; min-width: 50%;
  border-top: 1.5px solid var(--ink); border-bottom: 1.5px solid var(--ink); }
caption { text-align: left; font-weight: 600; padding-bottom: .3rem; font-size: .9rem; }
th, td { padding: .22rem .6rem; text-align: left; vertical-align: baseline; }
thead th { border-bottom: 1px solid var(--ink); vertical-align: bottom; }
tbody th { font-weight: 500; }
table.plain tbody tr:nth-child(even) { background: var(--tint); }
table.grouped tbody { border-top: 1px solid var(--rule); }
th[scope="rowgroup"] { font-weight: 600; }
.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
thead th.number { white-space: normal; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(24rem, 1fr)); gap: 1rem;
  align-items: end; }
figure { margin: .4rem 0; } figure img { width: 100%; height: auto; display: block; }
figure.model { max-width: 44rem; }
figure.chart { max-width: 44rem; } .chart svg { width: 100%; height: auto; display: block; }
.chart text { font-size: 12.5px; fill: var(--ink); } .chart rect { fill: var(--accent); }
.chart rect.over { fill: #b3261e; } .chart .axis { stroke: var(--ink); }
.chart .limit { stroke: #b3261e; stroke-dasharray: 4 3; }
figcaption { font-size: .84rem; color: var(--faint); }
footer { margin-top: 3rem;
  border-top: 1px solid var(--rule); color: var(--faint); font-size: .84rem; }
@media (max-width: 45rem) {
  .key, .figures { grid-template-columns: 1fr; } nav ol { columns: 1; }
}
@media print {
  @page { size: A4; margin: 16mm 14mm 18mm; }
  body { font-size: 9.5pt; max-width: none; padding: 0; }
  h2, h3, caption { break-after: avoid; }
  tr, figure, table.short, .key div, .verdict { break-inside: avoid; }
  thead { display: table-header-group; break-after: avoid; }
  tbody:first-of-type tr:first-child { break-before: avoid; break-after: avoid; }
  .table { overflow: visible; } table { font-size: 7.6pt; min-width: 0; }
  th, td { padding: .12rem .35rem; }
  figure.model, figure.chart { max-width: 13cm; } footer { display: none; }
  .figures { grid-template-columns: 1fr 1fr; gap: .6rem; }
  nav a { color: inherit; text-decoration: none; }
  .verdict, tbody tr, .key div, .chart rect { print-color-adjust: exact;
    -webkit-print-color-adjust: exact; }
}
""".strip()
