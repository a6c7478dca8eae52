"""Pictures, movies and pages, without a GPU or a window, that show whether a transfer worked.

camera -> zbuffer -> textures, shading -> raster     one picture
sheet, movie, heat                                   sheets, movies and heat maps made of pictures
pack, page                                           the offline page: its packed data, and its HTML
"""
