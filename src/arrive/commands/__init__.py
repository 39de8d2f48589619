"""The commands, one module per group. A module is imported when its command runs, so that help is fast."""
