"""Control: measured state and set-point go in, rotor speeds come out; gains from phase margins."""
