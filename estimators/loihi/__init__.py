"""Emulated Loihi: neurons in its integers, and where on its cores they go."""
