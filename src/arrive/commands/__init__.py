"""What each command does, one module per group; imported when it is called, so that help answers at once."""
