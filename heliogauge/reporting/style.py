"""The look of a report: one style sheet, within the page, nothing loaded from elsewhere."""

STYLE = """\
:root { --ink: #1f2a36; --faint: #66717d; --line: #dfe3e8; --accent: #1b6ca8; --warn: #b4421c; }
* { box-sizing: border-box; }
body { margin: 0; color: var(--ink); background: #eef1f4;
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif; }
nav { position: sticky; top: 0; z-index: 9; display: flex; flex-wrap: wrap; gap: 0 1.3em; justify-content: center;
  padding: .5em 1em;
  background: rgba(255, 255, 255, .96); border-bottom: 1px solid var(--line); font-size: .85em; }
nav a { color: var(--faint); text-decoration: none; padding: .15em 0; }
nav a:hover { color: var(--accent); }
main { max-width: 1240px; margin: 1.5em auto 3em; padding: 1.5em 2.5em 3em; background: #fff;
  border: 1px solid var(--line); border-radius: 8px; }
h1 { font-size: 1.9em; line-height: 1.2; margin: .3em 0 .1em; }
h2 { font-size: 1.35em; margin: 2.2em 0 .5em; padding-top: .9em; border-top: 1px solid var(--line);
  scroll-margin-top: 2em; }
h3 { font-size: 1.08em; margin: 1.5em 0 .4em; }
p, li { max-width: 75em; }
a { color: var(--accent); }
code { font-size: .9em; background: #f3f5f7; padding: .1em .3em; border-radius: 3px; overflow-wrap: anywhere; }
.subtitle { color: var(--faint); margin: 0 0 1.2em; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(380px, 1fr)); gap: .6em 1.2em;
  align-items: start; margin: .8em 0; }
.figures figure { margin: 0; text-align: center; }
.figures img { width: 100%; max-width: 576px; height: auto; }
.figures .wide { grid-column: 1 / -1; }
.figures .wide img { max-width: 1152px; }
.caption { color: var(--faint); font-size: .9em; margin: .2em 0 1em; }
.warnings { border-left: 5px solid var(--warn); background: #fdf3ee; padding: .7em 1.2em; margin: 1em 0;
  border-radius: 0 6px 6px 0; }
.warnings strong { color: var(--warn); }
.warnings li.serious { font-weight: 600; }
.warnings li.note { color: var(--faint, #667); }
.warnings ul { margin: .3em 0; padding-left: 1.2em; }
.fine { border-left: 5px solid #2f8f5b; background: #eff8f2; padding: .7em 1.2em; margin: 1em 0;
  border-radius: 0 6px 6px 0; }
.table { overflow-x: auto; margin: .8em 0; }
table { border-collapse: collapse; font-size: .93em; }
th, td { text-align: left; padding: .32em 1.1em .32em .2em; border-bottom: 1px solid var(--line);
  vertical-align: top; }
thead th { border-bottom: 2px solid var(--ink); font-weight: 600; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
td.hash { font: .85em ui-monospace, "DejaVu Sans Mono", monospace; color: var(--faint); overflow-wrap: anywhere; }
.headline table { width: 100%; font-size: 1.02em; }
.headline td.number { font-weight: 600; }
pre { white-space: pre-wrap; font-size: .85em; }
details summary { cursor: pointer; color: var(--accent); }
@media print { nav { display: none; } body { background: #fff; } main { border: 0; margin: 0; max-width: none;
  padding: 0; }
  .figures figure, tr { break-inside: avoid; } h2, h3 { break-after: avoid; } }
"""
