from .store import default_uri as default_uri
from .study_view import mark_study as mark_study
from .study_view import publish_study as publish_study
from .task_view import TaskView as TaskView
from .task_view import published_task as published_task
from .timer import following as following
from .timer import published_end as published_end
