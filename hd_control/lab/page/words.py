"""The answer of a diagnosis in plain sentences."""

from __future__ import annotations

from hd_control.drive.effect import UNITS
from hd_control.lab.balances.channels import shown_unit
from hd_control.lab.diagnosis.verdict import (
    ADEQUATE,
    CANNOT_TELL,
    MISSING,
    MISSING_AND_UNKNOWN,
    UNKNOWN,
    JointDiagnosis,
    NamedEffect,
)
from hd_control.lab.page.model_figures import Bar, percent
from hd_control.lab.page.style import CHANNELS

BADGES = {
    ADEQUATE: "nothing is missing",
    MISSING: "an effect is missing",
    UNKNOWN: "something unknown is missing",
    MISSING_AND_UNKNOWN: "an effect and something unknown are missing",
    CANNOT_TELL: "this recording cannot tell",
}


def plain_name(effect: str) -> str:
    """An effect's name as words."""
    return effect.replace("_", " ")


def headline(diagnosis: JointDiagnosis) -> str:
    """The verdict in one sentence."""
    if diagnosis.contradictions:
        return f"Signals and model contradict each other, so nothing is named: {'; '.join(diagnosis.contradictions)}."
    names = [plain_name(effect.name) for effect in diagnosis.effects]
    if diagnosis.verdict == ADEQUATE:
        return "The model explains this recording down to the noise; nothing is missing that the data show."
    if diagnosis.verdict == CANNOT_TELL:
        return "This recording does not excite the joint enough to say what is missing, or whether anything is."
    if diagnosis.verdict == UNKNOWN:
        return "Something is missing that is not in the library of effects."
    found = names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
    verb = "is" if len(names) == 1 else "are"
    more = ", and beside it something that is not in the library" if diagnosis.verdict == MISSING_AND_UNKNOWN else ""
    return f"{found[0].upper()}{found[1:]} {verb} missing in the model{more}."


def reasons(diagnosis: JointDiagnosis) -> list[str]:
    """What speaks for the verdict, one sentence each."""
    found = [_effect(effect, diagnosis) for effect in diagnosis.effects]
    if diagnosis.unknown is not None:
        found.append(_sentence(diagnosis.unknown.evidence))
    return found


def _effect(effect: NamedEffect, diagnosis: JointDiagnosis) -> str:
    factor, unit = shown_unit(UNITS[effect.channel])
    before, after = factor * effect.error_before, factor * effect.error_after
    name = plain_name(effect.name)
    text = (
        f"{name[0].upper()}{name[1:]} ({percent(effect.confidence)} sure) lowers the error of the "
        f"{CHANNELS[effect.channel]} from {before:.3g} to {after:.3g} {unit} on data that were not used for its fit"
    )
    if effect.channel in diagnosis.channels:
        text += f"; the noise is {factor * diagnosis.channels[effect.channel].noise_floor:.3g} {unit}"
    others = [plain_name(other) for other in effect.confusable_with]
    text += f". These data do not separate it from {' or '.join(others)}." if others else "."
    return text + " " + _sentence(effect.evidence)


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:].rstrip(".") + "." if text else ""


def confidence_bars(diagnosis: JointDiagnosis) -> list[Bar]:
    """One bar for each answer; unknown and cannot tell are answers like the others, without a probability."""
    bars = []
    for effect in diagnosis.effects:
        note = ""
        if effect.rivals:
            best = effect.rivals[0]
            share = 100.0 * min(1.0, best.share)
            note = f"runner-up: {plain_name(best.name)}, would explain {share:.0f} % of the gain"
        bars.append(Bar(effect.name, effect.confidence, note))
    if diagnosis.unknown is not None:
        on = " and ".join(plain_name(v) for v in diagnosis.unknown.variables)
        bars.append(Bar("unknown", None, f"{CHANNELS[diagnosis.unknown.channel]}, depends on {on}"))
    if diagnosis.verdict == CANNOT_TELL:
        bars.append(Bar("cannot_tell", None, "see the experiments"))
    return bars
