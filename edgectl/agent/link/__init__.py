"""Request path of the agent: boot program, dispatch, protocol, JSON, heartbeat."""
