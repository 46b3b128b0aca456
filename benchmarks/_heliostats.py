"""What the scripts of published heliostats share: lines of asked beside measured."""

import os
import time

from _measure import ONE_THREAD

from heliogauge.errors import EstimationError, InputError


def title(text):
    print(f"\n{text}\n  {'':66}{'asked':>25}{'measured':>34}  verdict")
    if any(os.environ.get(name) != value for name, value in ONE_THREAD.items()):
        print("(OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 are not set: times hold the waiting of idle threads)")


def line(what, asked, measured, holds):
    verdict = holds if isinstance(holds, str) else ("holds" if holds else "DIFFERS")
    print(f"  {what:66}{asked:>25}{measured:>34}  {verdict}", flush=True)


def close(what, asked, measured, tolerance):
    line(what, f"{asked:g}", f"{measured:.5g}", bool(abs(measured - asked) <= tolerance))


def within(what, low, high, measured, more=""):
    line(what, f"{low:g} to {high:g}", f"{measured:.2f}{more}", bool(low <= measured <= high))


def below(what, limit, measured, more=""):
    line(what, f"< {limit:.3g}", f"{measured:.2f}{more}", bool(measured < limit))


def run(studies, names):
    """Run some studies by name, all without names."""
    known = {study.__name__: study for study in studies}
    for name in names or known:
        began = time.process_time()
        try:
            known[name]()
        except (EstimationError, InputError) as error:
            print(f"  {name}: {error}")
        print(f"  ({name}: {time.process_time() - began:.0f} s of processor time)", flush=True)
