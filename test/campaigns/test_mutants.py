"""Branches and mutants of gate, guard, limits, monitors and drive side, compiled and in Python.

hd test --long G17; --count 60 takes about sixty of the compiled ones. All compiled mutants lie in one build, each is
switched on by a number.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue

import cpp_mutants
from builds import MODULES as LIBRARIES
from builds import build
from counts import count
from equivalent import reason_of
from mutants import MODULES, MutantServer, mutants, notices, notices_libraries, path_of, with_probes
from results import write_result

GOALS = ("G17",)

ENOUGH = 0.95
SAFETY = [
    library for library in LIBRARIES if library in ("hd_control._laws", "hd_control._chain", "hd_sim._drive_side")
]
"""Modules into which the rules go."""


def branches_missing(folder):
    """Conditions in Python that no test ends one way or the other, and how many ways there are."""
    missing, ways = [], 0
    for module, tests in MODULES.items():
        report = folder / module
        report.touch()
        source, number = with_probes(module, str(report))
        assert not notices(module, source, [*tests]), f"{module}: its tests fail with probes"
        seen = set(report.read_text().splitlines())
        ways += 2 * number
        missing += [f"{module} {n} {value}" for n in range(number) for value in (True, False)
                    if f"{n} {value}" not in seen]  # fmt: skip
    return missing, ways


def compiled_branches_missing(folder):
    """The same of the compiled rules: header, line and value of each condition that never ends so."""
    report, library = folder / "probes", build(cpp_mutants.probed(), SAFETY, folder / "probed")
    tests = list(dict.fromkeys(test for each in cpp_mutants.HEADERS.values() for test in each))
    assert not notices_libraries(library, tests, 3600.0, HD_PROBES=str(report)), "the tests fail with probes"
    seen, conditions = set(report.read_text().splitlines()), cpp_mutants.conditions()
    missing = [f"{header}:{line} {bool(value)}" for n, (header, line, _) in enumerate(conditions) for value in (0, 1)
               if f"{n} {value}" not in seen]  # fmt: skip
    return missing, 2 * len(conditions)


def survivors_of(chosen, noticed_by, **environment):
    """Mutants that no test notices, tried by as many servers as `HD_WORKERS` says, or as there are processors."""
    servers, workers = SimpleQueue(), int(os.environ.get("HD_WORKERS", os.cpu_count()))
    for _ in range(workers):
        servers.put(MutantServer(**environment))

    def noticed(mutant):
        server = servers.get()
        try:
            return noticed_by(server, mutant)
        finally:
            servers.put(server)

    with ThreadPoolExecutor(workers) as pool:
        dead = list(pool.map(noticed, chosen))
    while not servers.empty():
        servers.get().close()
    return [mutant for mutant, killed in zip(chosen, dead, strict=True) if not killed]


def python_survivors():
    """Survivors in words, and how many were tried and left out as alike."""
    every = [mutant for module in MODULES for mutant in mutants(module)]
    tried = [mutant for mutant in every if not reason_of(mutant.module, code_of(mutant), mutant.change)]
    left = survivors_of(tried, lambda server, m: server.notices(m.module, m.source, [*MODULES[m.module]]))
    return [f"{m.module}:{m.line} {m.change}: {code_of(m)}" for m in left], len(tried), len(every) - len(tried)


def compiled_survivors(folder):
    """The same of the compiled rules; and one in how many was tried."""
    every = cpp_mutants.mutants()
    step = -(-len(every) // count(len(every)))
    chosen = every[::step]
    tried = [mutant for mutant in chosen if not reason_of(mutant.header, mutant.code, mutant.change)]
    library = build(cpp_mutants.switched(), SAFETY, folder / "switched")
    left = survivors_of(
        tried, lambda server, m: server.notices_switched(m.number, [*cpp_mutants.HEADERS[m.header]]),
        HD_EXTENSIONS=str(library),
    )  # fmt: skip
    return [f"{m.header}:{m.line} {m.change}: {m.code}" for m in left], len(tried), len(chosen) - len(tried), step


def test_g17_branches_and_mutants(tmp_path):
    missing, ways = branches_missing(tmp_path)
    more, more_ways = compiled_branches_missing(tmp_path)
    missing, ways = missing + more, ways + more_ways
    left, tried, alike = python_survivors()
    survivors, compiled, same, step = compiled_survivors(tmp_path)
    share = 1.0 - (len(left) + len(survivors)) / (tried + compiled)
    some = f" (one in {step} of them)" if step > 1 else ""
    text = (
        f"{ways - len(missing)} of {ways} branch ends taken; {compiled - len(survivors)} of {compiled} mutants of the "
    )
    text += f"compiled rules{some} and {tried - len(left)} of {tried} in Python killed, {alike + same} more change "
    text += "nothing that can be seen"
    good = share >= ENOUGH and len(survivors) <= (1.0 - ENOUGH) * compiled
    write_result("G17", text, good and not missing and step == 1, survivors=[*left, *survivors], missing=missing,
                 compiled=compiled)  # fmt: skip
    assert not missing, missing
    assert good, "\n".join([*left, *survivors])


def code_of(mutant):
    """The line of code that was changed."""
    return path_of(mutant.module).read_text().splitlines()[mutant.line - 1].strip()
