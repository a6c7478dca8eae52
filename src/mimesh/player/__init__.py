"""The offline page that shows meshes and clips: what is packed into it, and how it is written."""
