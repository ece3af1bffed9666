"""What is to be linked: windows of walks, who is who in them, and what no task may reveal."""
