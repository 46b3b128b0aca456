"""The look of a report: one style sheet, within the page, nothing loaded from elsewhere."""

_LIGHT = """
  --paper: #ffffff; --ground: #eef1f4; --ink: #1f2a36; --faint: #5b6671; --line: #dfe3e8; --accent: #1b6ca8;
  --good: #1f7a4a; --good-ground: #edf7f0; --warn: #8a5200; --warn-ground: #fdf4e3;
  --bad: #a32a1c; --bad-ground: #fdeeea; --code: #f3f5f7; color-scheme: light;"""
_DARK = """
  --paper: #171d24; --ground: #0e1318; --ink: #e4e9ee; --faint: #9aa7b4; --line: #303a45; --accent: #6db6ee;
  --good: #6fce9a; --good-ground: #14271d; --warn: #f0b860; --warn-ground: #2b2212;
  --bad: #f39482; --bad-ground: #311a16; --code: #212932; color-scheme: dark;"""

STYLE = f"""\
:root {{{_LIGHT} }}
@media (prefers-color-scheme: dark) {{ :root:not([data-theme="light"]) {{{_DARK} }} }}
:root[data-theme="dark"] {{{_DARK} }}
* {{ box-sizing: border-box; }}
html {{ scroll-padding-top: 4.8em; }}
body {{ margin: 0; color: var(--ink); background: var(--ground);
  font: 16px/1.5 system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif; }}
nav {{ position: sticky; top: 0; z-index: 9; display: flex; gap: 1em; align-items: center; padding: .35em 1em;
  background: var(--paper); border-bottom: 1px solid var(--line); font-size: .85em; }}
nav div {{ display: flex; flex: 1; flex-wrap: wrap; gap: 0 1.3em; justify-content: center; }}
nav a {{ color: var(--faint); text-decoration: none; padding: .3em 0; white-space: nowrap; }}
nav a:hover, nav a:focus-visible {{ color: var(--accent); }}
nav button {{ font: inherit; font-size: 1.2em; line-height: 1; padding: .2em .4em; color: var(--faint);
  background: none; border: 1px solid var(--line); border-radius: 4px; cursor: pointer; }}
main {{ max-width: 1280px; margin: 0 auto 3em; padding: .6em 2.2em 3em; background: var(--paper); }}
h1 {{ font-size: 1.6em; line-height: 1.2; margin: .3em 0 0; overflow-wrap: anywhere; }}
h2 {{ font-size: 1.3em; margin: 2em 0 .5em; padding-top: .8em; border-top: 1px solid var(--line); }}
h3 {{ font-size: 1.08em; margin: 1.5em 0 .4em; }}
p, li {{ max-width: 75em; overflow-wrap: anywhere; }}
a {{ color: var(--accent); }}
code {{ font-size: .9em; background: var(--code); padding: .1em .3em; border-radius: 3px; overflow-wrap: anywhere; }}
.subtitle {{ color: var(--faint); margin: .1em 0 .7em; font-size: .92em; }}
.first {{ display: grid; gap: .8em 1.8em; grid-template-columns: minmax(0, 1fr); align-items: start; }}
.first > * {{ min-width: 0; }}
.first .figures {{ grid-template-columns: repeat(auto-fit, minmax(min(260px, 100%), 1fr)); margin: 0; }}
.picture .view {{ margin: 0; }}
.verdict {{ border-left: 5px solid var(--warn); background: var(--warn-ground); padding: .55em 1em;
  border-radius: 0 6px 6px 0; margin-bottom: .8em; font-size: .94em; }}
.verdict strong {{ color: var(--warn); font-size: 1.06em; }}
.verdict.sound {{ border-color: var(--good); background: var(--good-ground); }}
.verdict.sound strong {{ color: var(--good); }}
.verdict.failed {{ border-color: var(--bad); background: var(--bad-ground); }}
.verdict.failed strong {{ color: var(--bad); }}
.verdict ul {{ margin: .25em 0 0; padding: 0; list-style: none; }}
.verdict li {{ padding-left: 1.4em; text-indent: -1.4em; line-height: 1.4; margin-top: .15em; }}
.verdict li::before {{ display: inline-block; width: 1.4em; text-indent: 0; font-weight: 700; }}
.verdict li.missing {{ font-weight: 600; }}
.verdict li.missing::before {{ content: "\\25cb"; color: var(--warn); }}
.verdict li.doubtful::before {{ content: "!"; color: var(--warn); }}
.verdict li.serious::before {{ color: var(--bad); }}
.verdict li.passed::before {{ content: "\\2713"; color: var(--good); }}
.verdict li.note::before {{ content: "i"; color: var(--faint); }}
.verdict li a {{ color: inherit; text-decoration-color: var(--faint); }}
.numbers {{ width: 100%; }}
.numbers th {{ font-weight: 400; padding-right: .8em; }}
.numbers small {{ display: block; color: var(--faint); font-size: .82em; line-height: 1.25; }}
.numbers td.long {{ white-space: normal; }}
.numbers td {{ text-align: right; font-weight: 600; white-space: nowrap; font-variant-numeric: tabular-nums;
  padding-right: 0; }}
.doubts {{ padding-left: 1.2em; }}
.doubts li {{ margin: .4em 0; }}
.doubts li.serious {{ font-weight: 600; }}
.doubts li.serious::marker {{ color: var(--bad); }}
.doubts li.doubt::marker {{ color: var(--warn); }}
.doubts li.note {{ color: var(--faint); }}
.doubts li:target {{ background: var(--warn-ground); outline: .4em solid var(--warn-ground); }}
.figures {{ display: grid; grid-template-columns: repeat(auto-fit, minmax(min(360px, 100%), 1fr)); gap: .6em 1.2em;
  align-items: start; margin: .8em 0; }}
.figures figure {{ margin: 0; text-align: center; }}
.figures img {{ width: 100%; max-width: 576px; height: auto; border-radius: 3px; }}
@media screen {{
  :root[data-theme="dark"] .figures img {{ filter: brightness(.8); }}
}}
@media screen and (prefers-color-scheme: dark) {{
  :root:not([data-theme="light"]) .figures img {{ filter: brightness(.8); }}
}}
.figures .wide {{ grid-column: 1 / -1; }}
.figures .wide img {{ max-width: 1152px; }}
.beside {{ display: grid; grid-template-columns: repeat(auto-fit, minmax(min(420px, 100%), 1fr)); gap: .6em 1.4em;
  align-items: start; }}
.beside > * {{ min-width: 0; }}
.caption {{ color: var(--faint); font-size: .9em; margin: .2em 0 1em; }}
/* A shade at a side where a table goes on: the cover scrolls with the table, the shade does not. */
.table {{ overflow-x: auto; margin: .8em 0; background:
  linear-gradient(to right, var(--paper) 40%, transparent) 0 / 3em 100% no-repeat local,
  linear-gradient(to left, var(--paper) 40%, transparent) 100% / 3em 100% no-repeat local,
  linear-gradient(to right, var(--line), transparent) 0 / 1em 100% no-repeat scroll,
  linear-gradient(to left, var(--line), transparent) 100% / 1em 100% no-repeat scroll; }}
table {{ border-collapse: collapse; font-size: .93em; }}
th, td {{ text-align: left; padding: .3em 1.1em .3em .2em; border-bottom: 1px solid var(--line);
  vertical-align: top; }}
thead th {{ border-bottom: 2px solid var(--faint); font-weight: 600; }}
td.number, th.number {{ text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }}
td.hash {{ font: .85em ui-monospace, "DejaVu Sans Mono", monospace; color: var(--faint); overflow-wrap: anywhere; }}
.headline table {{ width: 100%; }}
.headline td.number {{ font-weight: 600; }}
pre {{ white-space: pre-wrap; font-size: .85em; overflow-wrap: anywhere; }}
summary {{ cursor: pointer; color: var(--accent); }}
:focus-visible {{ outline: 2px solid var(--accent); outline-offset: 2px; }}
@media (min-width: 900px) {{
  .first:not(.alone) {{ grid-template-columns: minmax(330px, 5fr) minmax(0, 8fr); }}
}}
@media (max-width: 600px) {{
  main {{ padding: .4em .9em 2em; }}
  nav {{ padding: .3em .9em; }}
  /* One line that scrolls, fading where it goes on. */
  nav div {{ flex-wrap: nowrap; justify-content: flex-start; overflow-x: auto; scrollbar-width: none;
    padding-right: 2em; mask-image: linear-gradient(to left, transparent, #000 2em); }}
  .numbers {{ font-size: .84em; }}
  .table td:first-child, .table th:first-child {{ min-width: 9em; }}
  .table td.sentence {{ min-width: 13em; }}
}}
@page {{ size: A4; margin: 12mm 12mm 14mm; }}
@media print {{
  :root, :root[data-theme] {{{_LIGHT} }}
  nav, .cell:not(.print), .caption:empty {{ display: none; }}
  body {{ background: none; font-size: 10.5pt; line-height: 1.35; }}
  main {{ max-width: none; padding: 0; margin: 0; }}
  h1 {{ margin-top: 0; }}
  h2 {{ margin: 1em 0 .3em; padding-top: .4em; }}
  h2, h3 {{ break-after: avoid; }}
  .first:not(.alone) {{ grid-template-columns: minmax(0, 5fr) minmax(0, 6fr); }}
  .figures {{ grid-template-columns: 1fr 1fr; gap: .3em .8em; margin: .3em 0; }}
  .first .figures {{ grid-template-columns: 1fr; }}
  .beside {{ grid-template-columns: 1fr 1fr; gap: .3em .8em; }}
  .beside .figures {{ grid-template-columns: 1fr; }}
  .figures figure, .verdict, tr {{ break-inside: avoid; }}
  .verdict, .table {{ print-color-adjust: exact; }}
  .table {{ overflow: visible; margin: .3em 0; background: none; }}
  table {{ font-size: .86em; }}
  th, td {{ padding: .18em .7em .18em .1em; }}
  th.number {{ white-space: normal; }}
  .wide table {{ font-size: .68em; }}
  .wide th, .wide td {{ padding-right: .45em; }}
  details {{ display: none; }}
}}
"""
