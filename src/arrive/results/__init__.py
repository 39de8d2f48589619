"""Result files: what the commands that measure write, and one reader that checks it."""
