"""Pictures without a GPU or a window: what shows that a transfer worked.

camera -> zbuffer -> paint, light -> raster     one picture
sheet, movie                                    pages and moving pictures of it
"""
