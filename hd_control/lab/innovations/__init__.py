"""The innovations of one joint: what a recording shows that rotor, spring and link do not predict."""
