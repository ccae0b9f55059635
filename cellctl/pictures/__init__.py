"""Pictures as files: read strictly, and written beside the work."""
