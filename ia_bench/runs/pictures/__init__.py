"""What a run looks like: drawn as it is scored, and kept in its folder, so that a report need not draw it again."""
