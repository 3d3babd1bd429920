// The API's document, drawn by Swagger UI. Nothing is remembered, and no other host validates the document.
globalThis.SwaggerUIBundle({
  url: "/openapi.json",
  dom_id: "#api",
  deepLinking: true,
  docExpansion: "list",
  validatorUrl: null,
});
