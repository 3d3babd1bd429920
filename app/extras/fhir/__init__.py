"""Records as read-only FHIR R5 resources: GET /fhir/NutritionIntake and its companions (docs/fhir.md)."""
