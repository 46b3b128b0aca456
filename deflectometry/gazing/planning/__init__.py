"""How far apart the cameras of backward gazing should stand: sigmas to be expected, and what will be blind."""
