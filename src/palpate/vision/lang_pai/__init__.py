"""lang_pai."""

from palpate.vision.lang_pai.flow import lang_pai_flow as lang_pai_flow
from palpate.vision.lang_pai.settings import LangPaiSettings as LangPaiSettings
from palpate.vision.lang_pai.vertices import lang_pai_vertices as lang_pai_vertices
