"""The offline page that shows meshes and clips: packing of its data, and writing of its HTML."""
