"""The drag-aided filter, alone and in interacting multiple models."""
