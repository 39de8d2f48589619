"""`arrive play`: a robot in the browser, run by the deployment controller, to be sent about by a person.

`playground` is the simulation, `pace` its clock and `history` what the plots show; none of them knows viser. `scene`
draws, `panel` and `stick` are the controls, and `session` ties all together in one thread.
"""
