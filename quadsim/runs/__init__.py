"""Running of jobs: atomic writing of files, worker processes, progress, fingerprints, compilation."""
