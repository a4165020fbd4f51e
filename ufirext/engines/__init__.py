"""The engines: how a window slides. All give the same numbers, each where it is fast."""
