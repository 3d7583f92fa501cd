"""From raw sensors to one state estimate: encoders, gauge bridge, derivative filter, fusion law."""
