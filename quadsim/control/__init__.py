"""Control: rotor speeds from the measured state and the set-point; gains from phase margins."""
