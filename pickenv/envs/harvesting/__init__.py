"""The Harvest environment: the machine of Li 2016."""
