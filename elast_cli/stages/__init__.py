"""What each command does: one module a command, each a `Step` from inputs to one artifact."""
