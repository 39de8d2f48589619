"""What each command does, one module per group."""

from arrive.commands.drive import drive
from arrive.commands.evaluation import evaluate, report
from arrive.commands.export import export, verify_file
from arrive.commands.names import list_names
from arrive.commands.play import play
from arrive.commands.training import train

__all__ = ["drive", "evaluate", "export", "list_names", "play", "report", "train", "verify_file"]
