"""Two models that become one."""
