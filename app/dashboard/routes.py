"""The dashboard's routes, a file a page. Who may see which: app/api/pages.py."""

from fastapi import APIRouter

from app.dashboard import item_actions, sign_in, studies

router = APIRouter(include_in_schema=False)
for page in (sign_in, studies, item_actions):
    router.include_router(page.router)
