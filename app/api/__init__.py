"""HTTP only: a file a resource; what a request means is the services' business."""
