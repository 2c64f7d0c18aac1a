"""Being led while measuring: each row judged as it comes, what is known by now, which pose is next, and when to stop."""
