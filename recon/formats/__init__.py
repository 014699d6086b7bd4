"""One module per family of point files; :mod:`recon.reading` chooses by content."""
