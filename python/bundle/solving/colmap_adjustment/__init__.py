"""Bundle adjustment of pycolmap's objects in place, as pycolmap does it."""
