"""The drag-aided filter: by itself, and in several models that interact."""
