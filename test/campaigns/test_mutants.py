"""Branches and mutants of gate, guard, limits and monitors. hd test --long G17; --count 60 takes about sixty."""

import os
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue

from counts import count
from equivalent import reason_of
from mutants import MODULES, MutantServer, mutants, notices, path_of, with_probes
from results import write_result

GOALS = ("G17",)

ENOUGH = 0.95


def branches_missing(folder):
    """Conditions that no test ends one way or the other: (module, number, value); and how many ways there are."""
    missing, ways = [], 0
    for module, tests in MODULES.items():
        report = folder / module
        report.touch()
        source, count = with_probes(module, str(report))
        assert not notices(module, source, [*tests]), f"{module}: its tests fail with probes"
        seen = set(report.read_text().splitlines())
        ways += 2 * count
        missing += [(module, n, value) for n in range(count) for value in (True, False) if f"{n} {value}" not in seen]
    return missing, ways


def survivors_of(chosen):
    """Mutants that no test notices, tried by as many servers as there are processors."""
    servers = SimpleQueue()
    for _ in range(os.cpu_count()):
        servers.put(MutantServer())

    def noticed(mutant):
        server = servers.get()
        try:
            return server.notices(mutant.module, mutant.source, [*MODULES[mutant.module]])
        finally:
            servers.put(server)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        dead = list(pool.map(noticed, chosen))
    while not servers.empty():
        servers.get().close()
    return [mutant for mutant, killed in zip(chosen, dead, strict=True) if not killed]


def test_g17_branches_and_mutants(tmp_path):
    missing, ways = branches_missing(tmp_path)
    every_mutant = [mutant for module in MODULES for mutant in mutants(module)]
    step = -(-len(every_mutant) // count(len(every_mutant)))
    chosen = every_mutant[::step]
    alike = [mutant for mutant in chosen if reason_of(mutant.module, code_of(mutant), mutant.change)]
    tried = [mutant for mutant in chosen if mutant not in alike]
    left = survivors_of(tried)
    share = 1.0 - len(left) / len(tried)
    some = f" (one in {step} of {len(every_mutant)})" if step > 1 else ""
    text = f"{ways - len(missing)} of {ways} branch ends taken; {len(tried) - len(left)} of {len(tried)} mutants "
    text += f"killed{some}, {len(alike)} more change nothing that can be seen"
    survivors = [f"{mutant.module}:{mutant.line} {mutant.change}: {code_of(mutant)}" for mutant in left]
    write_result("G17", text, share >= ENOUGH and not missing and step == 1, survivors=survivors,
                 missing=[list(map(str, each)) for each in missing])  # fmt: skip
    assert not missing, missing
    assert share >= ENOUGH, "\n".join(survivors)


def code_of(mutant):
    """The line of code that was changed."""
    return path_of(mutant.module).read_text().splitlines()[mutant.line - 1].strip()
