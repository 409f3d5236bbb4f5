"""The built-in anatomy: a mother's abdomen in the second trimester, with her fetus.

Each function that builds parts takes `scale`, the factor on every spacing of its grids and tubes, and most take
`seed`, which moves the surfaces a little. Of two parts that overlap, the later one owns the place.
"""
