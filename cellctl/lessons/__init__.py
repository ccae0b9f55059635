"""A recipe out of pictures of good parts."""
