"""`arrive play`: a simulated robot in the browser. The deployment controller runs it, and a person operates it.

`playground` is the simulation and `history` has the data of the plots; neither uses viser. `scene` draws, `panel` and
`stick` are the controls, and `session` runs them all in one thread. `door`, `connection` and `guard`
check what browsers send.
"""
