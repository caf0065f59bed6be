"""How stiff the fit is: the spectrum of its Gauss-Newton operator, and which unknowns the images confuse."""
