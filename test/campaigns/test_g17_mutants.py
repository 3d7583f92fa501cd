"""G17: branches and mutants of gate, guard, limits and monitors. `HD_MUTANTS` takes every n-th mutant, 1 by default."""

import os
from concurrent.futures import ThreadPoolExecutor

from mutants import MODULES, mutants, notices, with_probes
from results import write_result

EVERY = int(os.environ.get("HD_MUTANTS", "1"))
ENOUGH = 0.95


def branches_missing(folder):
    """Conditions that no test ends one way or the other: (module, number, value); and how many ways there are."""
    missing, ways = [], 0
    for module, tests in MODULES.items():
        report = folder / module
        report.touch()
        source, count = with_probes(module, str(report))
        assert not notices(module, source, [tests]), f"{module}: its tests fail with probes"
        seen = set(report.read_text().splitlines())
        ways += 2 * count
        missing += [(module, n, value) for n in range(count) for value in (True, False) if f"{n} {value}" not in seen]
    return missing, ways


def test_g17_branches_and_mutants(tmp_path):
    missing, ways = branches_missing(tmp_path)
    chosen = [mutant for module in MODULES for mutant in mutants(module)[::EVERY]]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        killed = list(pool.map(lambda m: notices(m.module, m.source, [MODULES[m.module]]), chosen))
    survivors = [f"{m.module}:{m.line} {m.change}" for m, dead in zip(chosen, killed, strict=True) if not dead]
    share = sum(killed) / len(killed)
    text = f"{ways - len(missing)} of {ways} branch ends taken; {sum(killed)} of {len(killed)} mutants killed" + (
        f" (every {EVERY}th)" if EVERY > 1 else ""
    )
    write_result(
        "G17", text, share >= ENOUGH and not missing, survivors=survivors, missing=[list(map(str, m)) for m in missing]
    )
    assert not missing, missing
    assert share >= ENOUGH, "\n".join(survivors)
