"""Observatory formats: FITS, NPY, ASCOM ImageBytes, SER, video."""
