"""Rendering without a GPU or a window: pictures of meshes and clips that show whether a transfer worked.

camera -> zbuffer -> textures, shading -> raster     one picture
sheet, movie, heat                                           sheets, movies and heat maps made of pictures
"""
