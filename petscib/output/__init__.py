"""What a run leaves behind: tables, checkpoints, pictures and the progress shown on the way."""
