"""What people come for, one folder a job."""
