"""How many sessions a service carries: clients on a schedule, more and more of them, until answers come late."""
