"""Random scenes, the properties that their answers must have, and tools to inspect one."""
