"""Records as FHIR R5 resources, read only: GET /fhir/NutritionIntake and what goes with it (docs/fhir.md)."""
