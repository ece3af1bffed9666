"""Further attacks for isac-track: `imm_rts`, `posterior` and `fusion`."""
