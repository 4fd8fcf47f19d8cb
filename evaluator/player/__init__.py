"""Environments in motion, coloured by which of them are bit-identical so far, for a page without a network.

clip.make_clip(recordings)   what is shown, as numbers and words
page.markup([clip])          the piece of a page; page.script() and page.style() go with it, once a page
page.render_page(...)        a whole page of its own
"""
