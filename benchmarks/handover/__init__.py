"""How well the written files, loaded by the programs that read them, predict what was held out."""
