"""Device drivers: speak the wire. Know no recipe, no cycle, no vision."""
