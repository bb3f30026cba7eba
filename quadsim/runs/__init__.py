"""How jobs run: files written whole, worker processes, progress, fingerprints for reuse, compilation."""
