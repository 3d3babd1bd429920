"""The capture page (`/capture`): a participant photographs meals in the browser of any phone.

Here are only its static files and their headers. All that it sends and shows goes over the API, as
for any other app.
"""
